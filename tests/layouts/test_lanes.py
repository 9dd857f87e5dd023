"""The lane that each car is in, or the nearest."""

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from helpers.lanes import EAST, PLAN, with_lanes
from helpers.scenes import polygons

from carpark_mj.layouts import build
from carpark_mj.layouts.routes import nearest_lane

nearest_lane_jit = jax.jit(nearest_lane)


def test_padding_is_no_lane():
    padded = with_lanes(
        build.lanes([(0.0, 0.0, EAST)] * 2, (4.0, 4.0)), mask=[True, False]
    )
    index, present = nearest_lane_jit(padded, jnp.array([(0.0, 0.0, 1.0)]))
    assert (int(index[0]), bool(present[0])) == (0, True)
    none = padded.replace(lane_mask=jnp.zeros(2, bool))
    assert not nearest_lane_jit(none, jnp.array([(0.0, 0.0, 1.0)]))[1].any()


def test_the_nearest_lane_is_shapely_s_and_on_a_crossing_the_one_along_the_car():
    rng = np.random.default_rng(0)
    pose = np.float32(rng.uniform((-30, -20, -3.1), (30, 20, 3.1), (2000, 3)))
    index, present = nearest_lane_jit(PLAN, jnp.asarray(pose))
    assert present.all()
    gap = shapely.distance(
        polygons(PLAN.lane_pose, PLAN.lane_size), shapely.points(pose[:, None, :2])
    )
    chosen = gap[np.arange(2000), np.asarray(index)]
    np.testing.assert_allclose(chosen, gap.min(axis=1), atol=1e-5)  # float32 at 30 m
    several = (gap == 0.0).sum(axis=1) > 1
    assert several.sum() > 5
    alike = np.cos(pose[:, None, 2] - np.asarray(PLAN.lane_pose)[:, 2])
    alike = np.where(gap == 0.0, alike, -np.inf)
    np.testing.assert_array_equal(index[several], alike.argmax(axis=1)[several])

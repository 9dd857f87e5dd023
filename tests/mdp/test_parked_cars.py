"""Which car fits where: shapely and the judge of collisions are the oracles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, lot, polygons

from carpark_mj.geometry import to_local, to_world
from carpark_mj.mdp.parked_cars import AWAY, fits, parked_poses, stand_in_bay, touches
from carpark_mj.mdp.terminations import find_hits

COUNT = 3000
ROUNDING = 2e-4  # m, float32 at coordinates of some 30 m and arcs near their ends


@pytest.fixture(scope="module")
def standing():
    """Random cars in random bays: bay, its size, car's size, wish, pose."""
    rng = np.random.default_rng(0)
    bay = rng.uniform((-30, -30, -np.pi), (30, 30, np.pi), (COUNT, 3))
    bay_size = rng.uniform((3.5, 1.8), (6.5, 3.0), (COUNT, 2))
    size = rng.uniform((3.3, 1.5), (5.2, 2.2), (COUNT, 2))
    wish = rng.normal(0, (0.5, 0.3, 0.3), (COUNT, 3))
    args = [x.astype(np.float32) for x in (bay, bay_size, size, wish)]
    return (*args, np.asarray(jax.jit(stand_in_bay)(*args)))


def test_a_car_that_fits_stays_within_the_lines(standing):
    bay, bay_size, size, _, pose = standing
    fit = (size <= bay_size).all(axis=1)
    assert 500 < fit.sum() < COUNT - 500
    lines = shapely.buffer(polygons(bay, bay_size), ROUNDING)
    assert shapely.covers(lines, polygons(pose, size))[fit].all()


def test_a_car_stands_no_further_off_than_wished_and_as_wished_where_it_may(standing):
    bay, bay_size, size, wish, pose = standing
    off = np.asarray(to_local(bay, pose))
    assert (np.abs(off) <= np.abs(wish) + ROUNDING).all()
    assert (off * wish >= -ROUNDING).all()
    wished = np.asarray(to_world(bay, wish))
    inside = shapely.covers(polygons(bay, bay_size), polygons(wished, size))
    assert inside.sum() > 50
    np.testing.assert_allclose(off[inside], wish[inside], atol=ROUNDING)


def test_the_heading_is_cut_no_more_than_the_lines_demand(standing):
    bay, bay_size, size, wish, pose = standing
    turned = np.asarray(to_local(bay, pose))[:, 2]
    fit = (size <= bay_size).all(axis=1)
    cut = fit & (np.abs(turned) < np.abs(wish[:, 2]) - 0.02)
    assert cut.sum() > 300
    more = bay.copy()
    more[:, 2] += turned + 0.01 * np.sign(wish[:, 2])
    lines = polygons(bay, bay_size)
    assert not shapely.covers(lines, polygons(more, size))[cut].any()


def test_a_car_that_does_not_fit_stands_in_the_middle_where_it_is_too_large():
    bay, size = jnp.zeros(3), jnp.array([5.0, 2.0])
    wish = jnp.array([0.5, 0.4, 0.2])
    stand = jax.jit(stand_in_bay)
    too_small = stand(bay, jnp.array([4.9, 1.9]), size, wish)
    np.testing.assert_allclose(too_small, [0.0, 0.0, 0.0], atol=1e-6)
    too_narrow = stand(bay, jnp.array([7.0, 1.9]), size, wish)
    np.testing.assert_allclose(too_narrow, [0.5, 0.0, 0.0], atol=1e-6)
    roomy = stand(bay, jnp.array([9.0, 9.0]), size, wish)
    np.testing.assert_allclose(roomy, wish, atol=1e-6)


def test_a_bay_must_leave_the_slack_in_length_and_in_width():
    bays = jnp.array([[5.0, 2.5], [4.4, 2.5], [5.0, 1.9], [4.3, 1.8]])
    car = jnp.array([4.3, 1.8])
    np.testing.assert_array_equal(fits(bays, car), [True] * 4)
    np.testing.assert_array_equal(fits(bays, car, 0.05), [True, True, True, False])
    np.testing.assert_array_equal(fits(bays, car, 0.3), [True, False, False, False])
    both = fits(bays, jnp.array([[4.3, 1.8], [4.9, 2.0]]))
    np.testing.assert_array_equal(both[1], [True, False, False, False])


def test_absent_cars_stand_away_and_apart():
    layout = lot([(0.0, 5.0, 0.0), (10.0, 5.0, 1.0)])
    size = jnp.full((3, 2), 2.0)
    pose = parked_poses(layout, jnp.array([1, 2, 2]), size, None)
    np.testing.assert_allclose(pose[0], layout.bay_pose[1])
    assert (pose[1:, 0] >= AWAY).all()
    assert pose[2, 0] - pose[1, 0] > 10.0


def test_what_would_be_touched_is_what_the_judge_of_collisions_says():
    rng = np.random.default_rng(2)
    layout = lot(
        [(0.0, 0.0, 0.0)],
        walls=[(4.0, 0.0, 0.3), (-6.0, 3.0, 0.0)],
        wall_size=(6.0, 0.4),
        discs=[(0.0, -5.0, 0.4)],
    )
    layout = layout.replace(wall_mask=jnp.array([True, False]))
    pose = rng.uniform((-9, -9, -3), (9, 9, 3), (600, 3)).astype(np.float32)
    size = jnp.array([4.6, 1.9])
    parked = jnp.array([[2.0, 6.0, 0.7], [-5.0, -6.0, 2.0]])
    parked_size = jnp.array([[4.9, 1.9], [3.5, 1.6]])
    judge = jax.vmap(lambda x: find_hits(layout, x, parked, parked_size))
    hits = judge(cars(pose[:, None], size=size))
    expected = np.asarray(hits[1] | hits[2])[:, 0]
    assert 100 < expected.sum() < 500
    got = touches(layout, jnp.asarray(pose), size, parked, parked_size)
    np.testing.assert_array_equal(got, expected)

"""Routes by hand, and against shapely's linear referencing."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    Route,
    heading_at,
    point_at,
    project,
    speed_cap,
    stack_routes,
)

ROUTES = [Route(*ends) for ends in CONNECTIONS]
NAMES = ["-".join(ends) for ends in CONNECTIONS]
ARRAYS = stack_routes(ROUTES)


N = 50  # points of every call, so that all tests share a program
points_at, projections = (
    jax.jit(jax.vmap(f, in_axes=(None, 0))) for f in (point_at, project)
)


def only(k):
    return jax.tree.map(lambda x: x[k], ARRAYS)


def padded(*rows):
    return jnp.array([*rows, *rows[:1] * (N - len(rows))])


@pytest.mark.parametrize("k", range(len(ROUTES)), ids=NAMES)
def test_points_and_projections_are_those_of_the_polyline(k):
    line = shapely.LineString(ROUTES[k].points)
    assert float(ARRAYS.length[k]) == pytest.approx(line.length, abs=1e-3)
    along = np.linspace(0.0, line.length, N)
    found = points_at(only(k), jnp.array(along))
    expected = shapely.get_coordinates(line.interpolate(along))
    np.testing.assert_allclose(found, expected, atol=1e-4)

    xy = expected + np.random.default_rng(k).uniform(-1.0, 1.0, expected.shape)
    at, off = projections(only(k), jnp.array(xy))
    points = shapely.points(xy)
    np.testing.assert_allclose(np.abs(off), line.distance(points), atol=1e-4)
    np.testing.assert_allclose(at, line.project(points), atol=1e-3)


def test_a_route_goes_on_straight_beyond_its_ends():
    """East to south: x falls at the start, y at the end."""
    route = only(NAMES.index("east-EW-south-NS"))
    found = points_at(route, padded(-2.0, float(route.length) + 3.0))
    np.testing.assert_allclose(found[:2], [[40.22, 1.65], [-1.65, -42.02]], atol=1e-4)


def test_left_of_the_route_is_positive():
    route = only(NAMES.index("west-WE-east-WE"))
    along, off = projections(route, padded([-30.0, -1.0]))
    assert float(along[0]) == pytest.approx(8.54, abs=1e-4)
    assert float(off[0]) == pytest.approx(0.65, abs=1e-5)


def test_the_heading_turns_evenly_from_lane_to_lane():
    route = only(NAMES.index("south-SN-west-EW"))
    along = jnp.linspace(30.0, 50.0, 200)
    headings = jax.jit(jax.vmap(heading_at, in_axes=(None, 0, None)))
    yaw = headings(route, along, jnp.array(2.3))
    yaw = np.unwrap(yaw)
    assert yaw[0] == pytest.approx(np.pi / 2, abs=1e-3)
    assert yaw[-1] == pytest.approx(np.pi, abs=1e-3)
    turned = np.diff(yaw)
    assert turned.min() > -1e-3
    assert turned.max() < 0.1 * 0.4  # 0.1 m a step on a radius above 2.5 m


def test_cars_slow_down_for_curves_as_far_ahead_as_they_need():
    """13.89 m/s to 5.56 m/s at 5 m/s^2: (192.9 - 30.9) / 10 = 16.20 m."""
    left = only(NAMES.index("east-EW-south-NS"))
    curve = float(left.curve[0])
    caps = [float(speed_cap(left, jnp.array(curve - d), 5.0)) for d in (16.20, 0.0)]
    assert caps == pytest.approx([13.89, 5.56], abs=0.01)
    assert float(speed_cap(left, left.curve[1], 5.0)) == np.inf
    right = only(NAMES.index("west-WE-south-NS"))
    # A radius of 3.1 m at 5 m/s^2.
    assert float(right.curve_speed) == pytest.approx((3.1 * 5.0) ** 0.5, abs=1e-3)
    straight = only(NAMES.index("west-WE-east-WE"))
    assert float(speed_cap(straight, straight.curve[0], 5.0)) == np.inf


def test_a_route_that_does_not_exist_is_one_sentence():
    with pytest.raises(ValueError, match="no way leads from lane 'west-WE' to lane"):
        Route("west-WE", "west-EW")

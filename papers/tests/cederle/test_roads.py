"""The junction's roads, routes and scenarios."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from carpark_mj.config import SimConfig
from carpark_papers.cederle.junction import (
    SCENARIOS,
    JunctionConfig,
    JunctionEnv,
    roads,
)
from carpark_papers.cederle.junction.config import Mission, Scenario
from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    LANES,
    Route,
    heading_at,
    on_road,
    path_length,
    point_at,
    project,
    speed_cap,
    stack_routes,
)


@pytest.mark.parametrize(
    ("lane", "length"),
    [
        ("east-EW", 33.47),
        ("east-WE", 33.47),
        ("south-NS", 34.27),
        ("south-SN", 34.27),
        ("west-EW", 33.79),
        ("west-WE", 33.79),
    ],
)
def test_lanes_have_the_lengths_of_the_map(lane, length):
    assert path_length(LANES[lane]) == pytest.approx(length, abs=0.005)


@pytest.mark.parametrize(
    ("ends", "length"),
    [
        (("east-EW", "west-EW"), 9.50),
        (("east-EW", "south-NS"), 5.28 + 5.04),
        (("south-SN", "east-WE"), 5.00),
        (("south-SN", "west-EW"), 10.32),
        (("west-WE", "south-NS"), 5.00),
        (("west-WE", "east-WE"), 9.50),
    ],
)
def test_connections_have_the_lengths_of_the_map_and_join_their_lanes(ends, length):
    path = CONNECTIONS[ends]
    assert path_length(path) == pytest.approx(length, abs=0.006)
    assert path[0] == LANES[ends[0]][1]
    assert path[-1] == LANES[ends[1]][0]


def test_traffic_keeps_to_the_right():
    for start, end in LANES.values():
        ahead = np.subtract(end, start) / np.hypot(*np.subtract(end, start))
        middle = np.add(start, end) / 2
        # The road's axis, which runs through the origin, lies to the left.
        to_axis = -(ahead[0] * middle[1] - ahead[1] * middle[0])
        assert to_axis == pytest.approx(roads.LANE_OFFSET)


def test_asphalt_is_the_union_of_the_roads_with_rounded_corners():
    """The map's outline of the junction, whose corners are five points of an arc."""
    middle = [(4.75, 3.25), (4.75, -3.25), (3.92, -3.42), (3.62, -3.62), (3.42, -3.92)]
    middle += [(3.29, -4.29), (3.25, -4.75), (-3.25, -4.75), (-3.42, -3.92)]
    middle += [(-3.62, -3.62), (-3.92, -3.42), (-4.29, -3.29), (-4.75, -3.25)]
    middle += [(-4.75, 3.25)]
    road = shapely.union_all(
        [
            shapely.Polygon(middle),
            shapely.box(-38.54, -3.25, 38.22, 3.25),
            shapely.box(-3.25, -39.02, 3.25, -3.25),
        ]
    )
    xy = np.random.default_rng(0).uniform((-38, -39), (38, 8), (40_000, 2))
    points = shapely.points(xy)
    sure = shapely.distance(points, road.boundary) > 0.15
    expected = shapely.contains(road, points)
    found = np.asarray(on_road(jnp.array(xy)))
    np.testing.assert_array_equal(found[sure], expected[sure])
    near = np.hypot(np.abs(xy[:, 0]) - 4.1, xy[:, 1] + 4.1) < 1.0
    assert sure[near].sum() > 50  # the corners are among the points


def test_roads_go_on_beyond_the_ends_of_their_arms():
    xy = jnp.array([[50.0, 1.6], [-50.0, -1.6], [-1.6, -60.0], [50.0, 4.0], [0, 4.0]])
    assert on_road(xy).tolist() == [True, True, True, False, False]


@pytest.mark.parametrize(
    ("name", "lengths", "humans", "solved"),
    [
        ("2av", [53.8, 63.3], 0, 100),
        ("2av-hd", [68.1, 66.8], 1, 100),
        ("3av", [58.8, 59.6, 58.3], 0, 120),
        ("3av-hd", [63.8, 64.6, 63.3], 1, 120),
    ],
)
def test_missions_are_as_long_as_those_of_the_study(name, lengths, humans, solved):
    scenario = SCENARIOS[name]
    found = [mission.length for mission in scenario.missions]
    assert found == pytest.approx(lengths, abs=0.05)
    assert len(scenario.human_cars) == humans
    assert scenario.solved == solved


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"scenario": "4av"}, "unknown scenario '4av'; choose from"),
        ({"jitter": 14.0}, r"jitter must be at most 13.47 m.*not 14.0"),
        (
            {"scenario": "3av-hd", "jitter": 5.1},  # 10 m behind the human-driven car
            "jitter must be at most 5.00 m, or a car would start within another one",
        ),
    ],
)
def test_impossible_settings_are_one_sentence(settings, message):
    with pytest.raises(ValueError, match=message):
        JunctionConfig(**settings)


@pytest.mark.parametrize("start", [-0.1, 33.5, float("nan")])
def test_a_mission_starts_on_its_lane(start):
    route = Route("east-EW", "south-NS")
    assert Mission(route, 33.47, 60.0).length == pytest.approx(10.32 + 34.27, abs=0.01)
    said = (
        rf"start of a mission must lie in \[0, 33.47\] m on lane 'east-EW', not {start}"
    )
    with pytest.raises(ValueError, match=said):
        JunctionConfig(scenario=Scenario((Mission(route, start, 30.0),), (), 0.0))


def test_impossible_parts_are_one_sentence():
    with pytest.raises(ValueError, match="no way leads from lane 'west-WE' to lane"):
        Route("west-WE", "west-EW")
    with pytest.raises(ValueError, match="unknown vehicle 'tank'"):
        JunctionEnv(JunctionConfig(cars="mjx", vehicle="tank"))
    icy = SimConfig(ctrl_dt=0.1, surface="ice")
    with pytest.raises(ValueError, match="bicycle physics, which has no tyres"):
        JunctionEnv(JunctionConfig(cars="bicycle", sim=icy))


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


def test_a_route_goes_on_beyond_its_ends_and_its_left_is_positive():
    """East to south: x falls at the start, y at the end."""
    route = only(NAMES.index("east-EW-south-NS"))
    found = points_at(route, padded(-2.0, float(route.length) + 3.0))
    np.testing.assert_allclose(found[:2], [[40.22, 1.65], [-1.65, -42.02]], atol=1e-4)
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

"""Lanes and connections against the published map, asphalt against shapely."""

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from carpark_papers.cederle.junction import roads
from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    LANES,
    on_road,
    path_length,
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

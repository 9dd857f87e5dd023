"""Polygons become the rectangles that fit them."""

import pytest
import shapely
from shapely import affinity

from carpark_mj.maps.fit import boxes, cut_free

SHAPES = {
    "L": shapely.box(0, 0, 10, 1).union(shapely.box(0, 0, 1, 8)),
    "ring": shapely.box(0, 0, 10, 8).difference(shapely.box(1, 1, 9, 7)),
    "arc": shapely.Point(0, 0).buffer(10).boundary.buffer(0.5),
    "fine arc": shapely.Point(0, 0).buffer(10, quad_segs=150).boundary.buffer(0.5),
    "triangle": shapely.Polygon([(0, 0), (10, 0), (0, 5)]),
}


@pytest.mark.parametrize("name", SHAPES)
def test_rectangles_cover_a_polygon_and_little_else(name):
    shape = SHAPES[name]
    cover = shapely.union_all([box.shape for box in boxes(shape)])
    assert shape.difference(cover).area < 1e-3
    assert cover.difference(shape.buffer(0.8)).area == 0


@pytest.mark.parametrize("turn", [0.0, 0.6, 1.1, 1.9, 2.6, 3.7])
def test_right_angles_are_cut_at_their_corners(turn):
    stair = SHAPES["L"].union(shapely.box(-6, 7, 1, 8))
    shape = affinity.rotate(stair, turn, use_radians=True)
    assert len([*boxes(shape)]) == 3


def test_a_rectangle_cut_free_keeps_the_most_that_it_can():
    [box] = boxes(shapely.box(0, 0, 10, 4))
    free = cut_free(box, [shapely.box(-5, 3.5, 20, 9), shapely.box(9, 0, 12, 1)])
    assert free is not None
    assert free.shape.area == pytest.approx(9 * 3.5, rel=0.01)
    assert cut_free(box, [shapely.box(-1, -1, 11, 5)]) is None


def test_a_row_along_a_rectangle_costs_one_side():
    # Corners of six leaning bays that reach into a lane.
    [lane] = boxes(shapely.box(0, 0, 40, 6))
    corners = [shapely.box(x, 5.2, x + 1.0, 7) for x in range(2, 38, 6)]
    free = cut_free(lane, corners)
    assert free is not None
    assert free.size == pytest.approx((40.0, 5.2), abs=0.01)

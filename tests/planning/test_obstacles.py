"""Free space against shapely."""

import numpy as np
import shapely
from helpers.scenes import polygons

from carpark_mj.planning.obstacles import FreeSpace, Solids

EXTENT = np.array([12.0, 8.0])
SIZE = (4.7, 1.9)


def draw(rng, count):
    pose = rng.uniform(-1, 1, (count, 3)) * [*EXTENT, np.pi]
    return pose, rng.uniform(0.2, 3.0, (count, 2))


def test_a_pose_is_free_exactly_where_shapely_finds_no_overlap():
    rng = np.random.default_rng(0)
    pose, size = draw(rng, 6)
    centre, radius = rng.uniform(-6, 6, (2, 2)), np.array([0.3, 0.8])
    solids = Solids(pose, size, centre, radius)
    space = FreeSpace(solids, SIZE, EXTENT)
    discs = shapely.points(centre)
    solid = shapely.union_all(polygons(pose, size))
    cars, _ = draw(rng, 4000)
    free = np.array([space.is_free(*car) for car in cars])
    bare = FreeSpace(solids, SIZE, EXTENT, grid=False)
    assert [bare.is_free(*car) for car in cars] == free.tolist()
    inside, outside = (
        polygons(cars, np.array(SIZE) + change) for change in (-1e-6, 1e-6)
    )

    def clear(boxes):
        gaps = shapely.distance(boxes[:, None], discs) > radius
        return ~shapely.intersects(boxes, solid) & gaps.all(axis=1)

    sure = clear(inside) == clear(outside)
    assert sure.mean() > 0.99
    np.testing.assert_array_equal(free[sure], clear(outside)[sure])
    assert 0.1 < free.mean() < 0.9


def test_nothing_is_free_outside_the_lot():
    nothing = Solids(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    space = FreeSpace(nothing, SIZE, EXTENT)
    assert space.is_free(11.9, -7.9, 1.0)
    for x, y in ((12.1, 0.0), (-12.1, 0.0), (0.0, 8.1), (0.0, -8.1)):
        assert not space.is_free(x, y, 0.0)
    wall = nothing.with_boxes(np.zeros((1, 3)), np.ones((1, 2)))
    assert not FreeSpace(wall, SIZE, EXTENT).is_free(0.0, 0.0, 0.3)

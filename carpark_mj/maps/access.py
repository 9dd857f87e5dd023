"""Where cars may start in a map without lanes, and which spots walls keep them from."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from carpark_mj.layouts.standards import DesignCar
from carpark_mj.maps.fit import Box, boxes, cut_free

APRON = 6.0  # m of free ground around the spots of a map that has no ground
ROUNDING = 0.01  # m by which walls beside a bay may reach into the car's room
NARROW = 0.5  # m cut off the free ground, by which rectangles may reach beyond it


def ground_around(spots: Sequence[Any]) -> Any:
    """The ground that a map without lanes or outlines of ground is taken to have."""
    return shapely.union_all(spots).convex_hull.buffer(APRON, join_style="mitre")


def free_starts(ground: Any, taken: Sequence[Any]) -> list[Box]:
    """Rectangles in the ground, clear of shapes, that a car has room for.

    Args:
        ground: a shapely shape that can be driven on.
        taken: shapely polygons that stand on it.
    """
    free = ground.difference(shapely.union_all(taken)).buffer(-NARROW)
    tree, found = shapely.STRtree(taken), []
    for box in boxes(free):
        met = tree.geometries[tree.query(box.shape, "intersects")]
        if (clear := cut_free(box, met)) and clear.length >= clear.width:
            found.append(clear)
        elif clear:
            found.append(Box(*clear.pose[:2], clear.yaw + np.pi / 2, *clear.size[::-1]))
    return found


def walled_off(
    bays: Sequence[Box], starts: Sequence[Box], solids: Sequence[Any]
) -> list[int]:
    """Indices of the bays that no start has a way to between solids.

    A necessary test: a disc as wide as the car passes wherever cars do, but not the
    other way round.

    Args:
        bays: of a lot.
        starts: in which cars begin.
        solids: shapely polygons of walls, kerbs and columns.
    """
    radius = DesignCar().width / 2 - ROUNDING
    grown = shapely.union_all([solid.buffer(radius) for solid in solids])
    places = [shapely.Point(box.x, box.y) for box in (*bays, *starts)]
    whole = shapely.box(*shapely.total_bounds([grown, *places])).buffer(1.0)
    tree = shapely.STRtree(shapely.get_parts(whole.difference(grown)))
    parts = [set(tree.query(place, "intersects").tolist()) for place in places]
    reached = set[int]().union(*parts[len(bays) :])
    return [k for k, part in enumerate(parts[: len(bays)]) if not part & reached]

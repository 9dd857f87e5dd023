"""The Dragon Lake car park: 364 bays on 140 m x 80 m.

Source: rows, aisles and the entrance of the map of the Dragon Lake Parking data set
(Shen et al., "ParkPredict+", 2022); facts of the published map, none of its data.
"""

import math

import numpy as np

from carpark_mj.layouts import build
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import Layout

SIZE = np.array([140.0, 80.0])  # m
# Opposite corners of rows of bays [m], rows behind each other and bays in each.
ROWS_OF_BAYS = (
    ((28.53, 73.73), (138.42, 68.51), 1, 42),
    ((7.71, 61.4), (76.54, 50.4), 2, 25),
    ((83.82, 61.4), (138.42, 50.4), 2, 21),
    ((7.71, 43.24), (76.54, 31.93), 2, 25),
    ((83.82, 43.24), (138.42, 31.93), 2, 21),
    ((7.71, 24.68), (76.54, 13.51), 2, 25),
    ((83.82, 24.68), (138.42, 13.51), 2, 21),
    ((7.71, 6.48), (76.54, 0.95), 1, 25),
    ((83.82, 6.48), (138.42, 0.95), 1, 21),
)
AISLES_Y = (64.95, 46.82, 28.3, 9.99)  # of centre lines along x [m]
AISLES_X = (3.07, 80.18)  # of those along y [m]
WIDTH = 6.0  # m of an aisle; the rows leave 6.1 m and more between them


def dragon_lake() -> Layout:
    """Makes the lot, its middle at the origin; traffic keeps to the right."""
    poses, sizes = [], []
    for (left, top), (right, bottom), rows, count in ROWS_OF_BAYS:
        width, length = (right - left) / count, (top - bottom) / rows
        for row in range(rows):
            y = top - (row + 0.5) * length
            # The aisle is above the upper of two rows; one row faces the middle.
            up = row == 0 if rows == 2 else y < SIZE[1] / 2
            for bay in range(count):
                yaw = math.pi / 2 if up else -math.pi / 2
                poses.append((left + (bay + 0.5) * width, y, yaw))
                sizes.append((length, width))
    east = ROWS_OF_BAYS[0][1][0]
    aisles = [(east / 2, y, 0.0) for y in AISLES_Y]
    low, high = AISLES_Y[-1] - WIDTH / 2, AISLES_Y[0] + WIDTH / 2
    aisles += [(x, (low + high) / 2, math.pi / 2) for x in AISLES_X]
    along = [(east, WIDTH)] * len(AISLES_Y) + [(high - low, WIDTH)] * len(AISLES_X)
    shift = np.array([*SIZE / 2, 0.0])
    lanes, lane_sizes = build.two_lanes(np.array(aisles) - shift, np.array(along))
    return build.assemble(
        SIZE / 2,
        build.bays(np.array(poses) - shift, np.array(sizes)),
        build.lanes(lanes, lane_sizes),
        build.spawns_in(DesignCar(), lanes, lane_sizes),
    )

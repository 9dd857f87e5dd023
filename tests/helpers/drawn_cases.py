"""What has drawn the stored cases of the suite: HOPE's levels and `busy`."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.layouts.registry import TEST, lot_key
from carpark_mj.layouts.standards import Level, Orientation
from carpark_mj.layouts.types import Layout, layout_maxima, pad_layout
from carpark_mj.suite.busy import (
    CART,
    COLUMNS,
    GROUPS,
    HALF_X,
    LENGTH,
    VERSION,
    WIDTH,
    bay_x,
    unit,
)
from carpark_mj.suite.hope import HopeConfig
from carpark_mj.suite.levels import CASES, HOPE_LEVELS, METRE, POSE, STORED
from carpark_mj.suite.tpcap import TPCAP_CAR

CHILD, ADULT = 0.5, 0.56  # m, twice the radius
PACE = 2.0  # m/s, of a car that is met


def draw_hope(level: Level, count: int = CASES) -> dict[str, np.ndarray]:
    """Draws the first cases of a level, as the file has them: (count, ...) integers."""
    orientations: tuple[Orientation, ...] = ("perpendicular", "parallel")
    if level == "extreme":
        orientations = ("parallel",)
    first = TEST.start + HOPE_LEVELS.index(level) * CASES
    draws = [jax.jit(HopeConfig(level, turn).generate) for turn in orientations]
    layouts: list[Layout] = []
    # In double precision: the rounded numbers are then the same on any machine.
    with jax.enable_x64(True):
        for index in range(count):
            draw, key = draws[index % len(draws)], lot_key(jnp.uint32(first + index))
            layouts.append(jax.device_get(draw(key)))
    maxima = layout_maxima(layouts)
    stacked = [jax.device_get(pad_layout(layout, maxima)) for layout in layouts]
    lots = jax.tree.map(lambda *rows: np.stack(rows), *stacked)
    parallel = np.arange(count) % len(orientations) == len(orientations) - 1

    poses = {"goal": lots.bay_pose[:, 0], "start": lots.spawn_pose[:, 0]}
    poses["wall"] = lots.wall_pose
    sizes = {"bay": lots.bay_size[:, 0], "size": lots.wall_size, "extent": lots.extent}
    whole = {name: np.rint(x / POSE).astype(np.int16) for name, x in poses.items()}
    whole |= {name: np.rint(x / METRE).astype(np.uint16) for name, x in sizes.items()}
    return {**{name: whole[name] for name in STORED[:-1]}, "parallel": parallel}


def _draw_case(number: int) -> dict[str, list[float]]:
    """Draws a case in metres, radians and seconds.

    Returns:
        `aisle`, its width; the car's `pose` and the bay `goal`; `absent`, a bay that
        the lot lacks; and of `Script` the fields of what gets in the way.
    """
    rng = np.random.default_rng([VERSION, number])
    group = GROUPS[number % len(GROUPS)]

    def draw(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    aisle = draw(6.0, 7.0)
    pose = [-HALF_X + draw(3.0, 4.0), -aisle / 4 + draw(-0.2, 0.2), draw(-0.05, 0.05)]
    goal = int(rng.integers(2)) * COLUMNS + int(rng.integers(6, COLUMNS))
    column, side = int(rng.integers(3, 6)), 1.0 - 2.0 * int(rng.integers(2))
    edge, across = side * aisle / 2, -side * math.pi / 2  # rows, and the way out of one
    between = bay_x(column) + WIDTH / 2  # two bays
    absent = -1
    script: dict[str, Any] = dict.fromkeys(("pause", "returns", "slowing"), 0.0)
    script["direction"] = across

    def meet(depth: float) -> float:
        """Distance of a car at `PACE` as a person reaches its way."""
        way = abs(edge + side * depth - pose[1])
        return TPCAP_CAR.length / 2 + PACE * way / script["speed"]

    if group == "dart_out":  # from the gap between two cars into that opposite
        depth = draw(0.8, 1.5)
        script |= {"start": [between, edge + side * depth, across]}
        script |= {"distance": aisle + 2 * depth, "speed": draw(2.0, 3.0)}
        script |= {"trigger": meet(depth) + draw(0.0, 2.0), "size": [CHILD, CHILD]}
    elif group == "backing_out":  # a car parked nose in
        absent = column + (COLUMNS if side > 0 else 0)
        yaw = math.remainder(across + math.pi, math.tau)
        script |= {"start": [bay_x(column), edge + side * LENGTH / 2, yaw]}
        script |= {"distance": draw(2.5, aisle - 1.5)}
        script |= {"speed": draw(0.6, 1.2), "trigger": draw(6.0, 11.0)}
        script |= {"pause": draw(1.0, 4.0), "returns": 1.0}
        script |= {"size": [TPCAP_CAR.length, TPCAP_CAR.width]}
    elif group == "cart":  # rolls askew and stays where it stops
        yaw = across + draw(-0.7, 0.7)
        way = (aisle - 1.2) / math.cos(yaw - across)
        script |= {"start": [between, edge - side * 0.6, yaw], "direction": yaw}
        script |= {"distance": way, "speed": draw(0.8, 1.8)}
        script |= {"slowing": draw(0.1, 0.3), "trigger": draw(5.0, 10.0)}
        script |= {"size": list(CART)}
    else:  # from the line of one row into the other; absent in a crowded aisle
        script |= {"start": [between, edge + side * 0.4, across]}
        script |= {"distance": aisle + 1.2, "speed": draw(0.9, 1.7)}
        script |= {"trigger": meet(0.4) + draw(0.0, 2.5), "size": [ADULT, ADULT]}
    car = {"aisle": aisle, "pose": pose, "goal": goal, "absent": absent}
    return {name: np.atleast_1d(x).tolist() for name, x in (car | script).items()}


def draw_busy(count: int = CASES) -> dict[str, np.ndarray]:
    """Draws the first cases as the file has them: (count, ...) whole numbers."""
    cases = [_draw_case(number) for number in range(count)]
    columns = {name: np.array([case[name] for case in cases]) for name in cases[0]}
    return {
        name: np.rint(x / unit(name, x.shape[1])).astype(np.int16)
        for name, x in columns.items()
    }

"""The held-out busy cases: 1,000, of five groups in turn, the same for all users.

The package stores them in whole millimetres, 1e-4 rad, mm/s and ms. `write` draws the
same bytes again.
"""

import functools
import hashlib
import io
import math
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.studies.busy.aisle import COLUMNS, HALF_X, LENGTH, WIDTH, bay_x
from carpark_mj.studies.tpcap.files import TPCAP_CAR

VERSION = 1
FILE = Path(__file__).with_name(f"busy_{VERSION}.npz")
SHA256 = "6004375ac7decf7dd5d427f72a45b2f20f606a670a4d605a124abec02d2c4c63"
CASES = 1000
GROUPS = ("crossing", "dart_out", "backing_out", "cart", "crowded_aisle")
STEP = 1e-3  # m, m/s, m/s² or s of the whole numbers in the file
RADIAN = 1e-4
CHILD, ADULT = 0.5, 0.56  # m, twice the radius
PACE = 2.0  # m/s, of a car that is met
CART = (1.0, 0.6)  # m


@functools.cache
def load_held_out() -> dict[str, np.ndarray]:
    """The columns of the cases, (1000, ...) whole numbers; see `draw_case`.

    Raises:
        ValueError: the file in the package is not the published one.
    """
    data = FILE.read_bytes()
    if (found := hashlib.sha256(data).hexdigest()) != SHA256:
        raise ValueError(
            f"{FILE} is not version {VERSION} of the busy cases: its SHA-256 is "
            f"{found}, not {SHA256}"
        )
    with np.load(io.BytesIO(data)) as file:
        return {name: file[name] for name in file.files}


def draw_case(number: int) -> dict[str, list[float]]:
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
    script: dict[str, Any] = {
        "pause": 0.0,
        "returns": 0.0,
        "slowing": 0.0,
        "direction": across,
    }

    def meet(depth: float) -> float:
        """How far off a car is that comes at `PACE` as somebody reaches its way."""
        way = abs(edge + side * depth - pose[1])
        return TPCAP_CAR.length / 2 + PACE * way / script["speed"]

    if group == "dart_out":  # from the gap between two cars into that opposite
        depth = draw(0.8, 1.5)
        script |= {"start": [between, edge + side * depth, across]}
        script |= {"distance": aisle + 2 * depth, "speed": draw(2.0, 3.0)}
        script |= {"trigger": meet(depth) + draw(0.0, 2.0), "size": [CHILD, CHILD]}
    elif group == "backing_out":  # a car parked nose in
        absent = column + (COLUMNS if side > 0 else 0)
        start = [
            bay_x(column),
            edge + side * LENGTH / 2,
            math.remainder(across + math.pi, math.tau),
        ]
        script |= {"start": start, "distance": draw(2.5, aisle - 1.5)}
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


def unit(name: str, width: int) -> np.ndarray:
    """(width,) steps of a column's whole numbers."""
    if name in ("goal", "absent", "returns"):
        return np.ones(1)
    steps = np.full(width, STEP)
    if name == "direction" or width == 3:
        steps[-1] = RADIAN
    return steps


def draw_cases(count: int = CASES) -> dict[str, np.ndarray]:
    """Draws the first cases as the file has them: (count, ...) whole numbers."""
    cases = [draw_case(number) for number in range(count)]
    columns = {name: np.array([case[name] for case in cases]) for name in cases[0]}
    return {
        name: np.rint(x / unit(name, x.shape[1])).astype(np.int16)
        for name, x in columns.items()
    }


def write(path: Path) -> None:
    """Draws all cases and writes them."""
    with path.open("wb") as file:  # by name, savez would choose another suffix
        np.savez(file, allow_pickle=False, **draw_cases())

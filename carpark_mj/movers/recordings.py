"""Recorded drives of cars, from trajectories (CSV) or what `carpark_mj play` saved.

A CSV has the columns id, time, x, y, yaw, length and width; a row is the pose of a
footprint's centre, s, m and rad. In a `.npz` file every episode of an agent is a car.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from carpark_mj.reading import TEXT, Archive, ArrayForm, parse_object, read_csv
from carpark_mj.vehicle.presets import preset

COLUMNS = ("id", "time", "x", "y", "yaw", "length", "width")
MOST_CARS = 200
LONGEST, WIDEST = 25.0, 5.0  # m, of a car


class Drives(NamedTuple):
    """Drives of cars (n,), padded to one number of samples k by repeating the last.

    Attributes:
        time: (n, k) float32, increasing from 0 for the first of all [s].
        pose: (n, k, 3) float32, yaw without jumps.
        size: (n, 2) float32 lengths and widths [m].
        end: (n,) float32 time of the last sample [s].
    """

    time: np.ndarray
    pose: np.ndarray
    size: np.ndarray
    end: np.ndarray


def read_drives(path: Path) -> Drives:
    """Reads a file of drives.

    Raises:
        ValueError: it is malformed; one sentence says where.
        OSError: it cannot be read.
    """
    if path.suffix not in (".csv", ".npz"):
        raise ValueError(f"a replay's file ends in .csv or .npz, not {path.name!r}")
    cars = _from_csv(path) if path.suffix == ".csv" else _from_archive(path)
    if not 1 <= len(cars) <= MOST_CARS:
        raise ValueError(f"{path} must hold 1 to {MOST_CARS} cars, not {len(cars)}")
    first = min(time[0] for time, _, _ in cars)
    most = max(len(time) for time, _, _ in cars)
    time = np.stack([np.pad(t - first, (0, most - len(t)), "edge") for t, _, _ in cars])
    pose = [np.pad(p, ((0, most - len(p)), (0, 0)), "edge") for _, p, _ in cars]
    pose = np.stack(pose)
    pose[..., 2] = np.unwrap(pose[..., 2], axis=1)
    size = np.array([size for _, _, size in cars])
    made = (time, pose, size, time[:, -1])
    return Drives(*(array.astype(np.float32) for array in made))


Car = tuple[np.ndarray, np.ndarray, tuple[float, float]]


def _from_csv(path: Path) -> list[Car]:
    rows: dict[str, list[list[float]]] = {}
    for row in read_csv(path, *COLUMNS):
        values = [row.number(name) for name in COLUMNS[1:]]
        if not all(map(math.isfinite, values)):
            raise ValueError(f"{row.place}: numbers must be finite, not {values}")
        length, width = values[4:]
        if not (0 < length <= LONGEST and 0 < width <= WIDEST):
            raise ValueError(
                f"{row.place}: length must be in (0, {LONGEST:g}] m and width in "
                f"(0, {WIDEST:g}] m, not {length:g} and {width:g}"
            )
        own = rows.setdefault(row.cells["id"], [])
        if own and values[0] <= own[-1][0]:
            raise ValueError(
                f"{row.place}: time must increase for each id, not be {values[0]:g} s "
                f"after {own[-1][0]:g} s"
            )
        if own and values[4:] != own[0][4:]:
            raise ValueError(f"{row.place}: the size of a car must stay the same")
        own.append(values)
    for name, own in rows.items():
        if len(own) < 2:
            raise ValueError(f"{path}: the car {name!r} needs 2 rows, not 1")
    tables = [np.array(own) for own in rows.values()]
    return [(t[:, 0], t[:, 1:4], (t[0, 4], t[0, 5])) for t in tables]


def _from_archive(path: Path) -> list[Car]:
    archive = Archive(path)
    text = archive.read({"header": ArrayForm(TEXT, ())})["header"]
    header = parse_object(str(text), f"the header of {path}", config=dict)
    config = header["config"]
    try:
        period = float(config["sim"]["ctrl_dt"])
        car = preset(config["vehicle"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"the header of {path} lacks {error}") from None
    poses = ArrayForm(np.dtype(np.float32), ("steps", "agents", 3))
    ends = ArrayForm(np.dtype(np.bool_), ("steps", "agents"))
    arrays = archive.read({"poses": poses, "terminated": ends, "truncated": ends})
    poses, ended = arrays["poses"], arrays["terminated"] | arrays["truncated"]
    if not np.isfinite(poses).all():
        raise ValueError(f"{path} holds poses that are not finite")
    time = period * (1.0 + np.arange(len(poses)))
    cars: list[Car] = []
    for agent in range(poses.shape[1]):
        # An agent that has ended is elsewhere in the next step.
        breaks = np.flatnonzero(ended[:, agent]) + 1
        for part in np.split(np.arange(len(poses)), breaks):
            if len(part) > 1:
                own = poses[part, agent].astype(np.float64)
                cars.append((time[part], own, (car.length, car.width)))
    return cars

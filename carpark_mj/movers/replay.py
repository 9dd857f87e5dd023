"""Cars that follow recorded poses.

Recordings are trajectories (CSV) or what `carpark_mj play` saved. A CSV has the columns
id, time, x, y, yaw, length and width; a row is the pose of a footprint's centre, s, m
and rad. In a `.npz` file every episode of an agent is a car.
"""

import dataclasses
import functools
import math
from pathlib import Path
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import Bounds, Range
from carpark_mj.files import require_suffix
from carpark_mj.geometry import wrap_angle
from carpark_mj.geometry.obstacles import Boxes, ObstacleKind
from carpark_mj.layouts.types import Layout
from carpark_mj.obstacles import MOVERS, Mover
from carpark_mj.reading import TEXT, Archive, ArrayForm, parse_object, read_csv
from carpark_mj.types import State
from carpark_mj.vehicle.presets import preset

COLUMNS = ("id", "time", "x", "y", "yaw", "length", "width")
LONGEST, WIDEST = 25.0, 5.0  # m, of a car
Car = tuple[np.ndarray, np.ndarray, tuple[float, float]]
PAUSE = 2.0  # s between the end of a recording and its next beginning
INSTANT = 0.05  # s about an instant, for the velocity


class Drives(NamedTuple):
    """Drives of cars (n,), padded to one number of samples k by repeating the last."""

    time: np.ndarray  # (n, k) float32, increasing from 0 for the first of all [s]
    pose: np.ndarray  # (n, k, 3) float32, yaw without jumps
    size: np.ndarray  # (n, 2) float32 lengths and widths [m]
    end: np.ndarray  # (n,) float32 time of the last sample [s]


def read_drives(path: Path) -> Drives:
    """Reads a file of drives; a `ValueError` says where it is malformed."""
    require_suffix("a replay's file", path.name, ".csv", ".npz")
    cars = _from_csv(path) if path.suffix == ".csv" else _from_archive(path)
    if not cars:
        raise ValueError(f"{path} holds no car")
    first = min(time[0] for time, _, _ in cars)
    most = max(len(time) for time, _, _ in cars)
    time = np.stack([np.pad(t - first, (0, most - len(t)), "edge") for t, _, _ in cars])
    rows = [np.pad(p, ((0, most - len(p)), (0, 0)), "edge") for _, p, _ in cars]
    pose = np.stack(rows)
    pose[..., 2] = np.unwrap(pose[..., 2], axis=1)
    size = np.array([size for _, _, size in cars])
    arrays = (time, pose, size, time[:, -1])
    return Drives(*(array.astype(np.float32) for array in arrays))


def _from_csv(path: Path) -> list[Car]:
    rows: dict[str, list[list[float]]] = {}
    for row in read_csv(path, *COLUMNS):
        values = [row.number(name) for name in COLUMNS[1:]]
        time, *_, length, width = values
        possible = 0.0 < length <= LONGEST and 0.0 < width <= WIDEST
        if not (possible and all(map(math.isfinite, values))):
            raise ValueError(
                f"{row.place}: numbers must be finite, lengths in (0, {LONGEST:g}] m "
                f"and widths in (0, {WIDEST:g}] m, not {values}"
            )
        own = rows.setdefault(row.cells["id"], [])
        if own and (time <= own[-1][0] or values[4:] != own[0][4:]):
            raise ValueError(
                f"{row.place}: the time of a car must increase and its size stay"
            )
        own.append(values)
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


@dataclasses.dataclass(frozen=True)
class Replay(Mover):
    """Cars of a recording, repeated; they stop for nothing.

    A car is there from its first to its last sample, and goes straight between them.

    Attributes:
        path: `.csv` or `.npz`, see the module; read when the config is made.
        offset: range of times of the recording at which lots begin [s]; None = any.
    """

    path: str = ""
    offset: Annotated[Range, Bounds(ge=0.0, le=1e6, unit="s")] | None = None
    mover: str = "replay"
    kind = ObstacleKind.DRIVER

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path:
            _ = self.drives

    @functools.cached_property
    def drives(self) -> Drives:
        """What the file holds."""
        if not self.path:
            raise ValueError("the mover 'replay' needs a path, as in replay:path=a.csv")
        try:
            return read_drives(Path(self.path))
        except OSError as error:
            raise ValueError(f"cannot read {self.path}: {error.strerror}") from None

    def init(self, key: jax.Array, layout: Layout) -> jax.Array:
        """The time in the recording [s]."""
        low, high = (0.0, self._period) if self.offset is None else self.offset
        start = jax.random.uniform(key, minval=low, maxval=high)
        return jnp.mod(start, self._period)

    def step(
        self, key: jax.Array, state: jax.Array, lot: State, dt: float
    ) -> jax.Array:
        """Time goes on."""
        return jnp.mod(state + dt, self._period)

    def obstacles(self, state: jax.Array) -> list[Boxes]:
        """A box for each car of the file."""
        drives = self.drives
        end = jnp.asarray(drives.end)
        there = (state >= drives.time[:, 0]) & (state <= end)
        before, pose, after = (_at(drives, state + d) for d in (-INSTANT, 0.0, INSTANT))
        velocity = (after - before)[:, :2] / (2.0 * INSTANT)
        pose = pose.at[:, 2].set(wrap_angle(pose[:, 2]))
        return [Boxes(pose, jnp.asarray(drives.size), velocity, there)]

    @property
    def _period(self) -> float:
        return float(self.drives.end.max()) + PAUSE


def _at(drives: Drives, time: jax.Array) -> jax.Array:
    """Poses (n, 3) at a time, interpolated."""
    column = jax.vmap(jnp.interp, (None, None, 1))  # over x, y and yaw
    return jax.vmap(column, (None, 0, 0))(time, drives.time, drives.pose)


MOVERS.register("replay", Replay())

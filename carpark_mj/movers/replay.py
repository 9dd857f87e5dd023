"""Replay: cars that drive as somebody has driven."""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Range, require_range
from carpark_mj.config.obstacles import MOVERS, Mover, ObstacleKind
from carpark_mj.geometry import wrap_angle
from carpark_mj.geometry.obstacles import Boxes
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.recordings import Drives, read_drives
from carpark_mj.types import State

PAUSE = 2.0  # s between the end of a recording and its next beginning
INSTANT = 0.05  # s about an instant, for the velocity


@dataclasses.dataclass(frozen=True)
class Replay(Mover):
    """Cars of a file of drives, again and again; they see nobody.

    A car is there from its first to its last sample, and goes straight from one to the
    next.

    Attributes:
        path: `.csv` or `.npz`, see `carpark_mj.movers.recordings`; read when the config
            is made.
        offset: time of the recording at which lots begin [s], drawn from this range;
            None = any.
        mover: fixed.
    """

    path: str = ""
    offset: Range | None = None
    mover: str = "replay"
    kind = ObstacleKind.DRIVER

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.offset is not None:
            require_range("offset", self.offset, 0.0, 1e6)
        if self.path:
            _ = self.drives

    @functools.cached_property
    def drives(self) -> Drives:
        """What the file holds.

        Raises:
            ValueError: no file is named, it cannot be read, or it is malformed.
        """
        if not self.path:
            raise ValueError("the mover 'replay' needs a path, as in replay:path=a.csv")
        try:
            return read_drives(Path(self.path))
        except OSError as error:
            raise ValueError(f"cannot read {self.path}: {error.strerror}") from None

    def init(self, key: Any, layout: Layout) -> jax.Array:
        """The time in the recording [s]."""
        del layout
        low, high = (0.0, self._period) if self.offset is None else self.offset
        start = jax.random.uniform(key, minval=low, maxval=high)
        return jnp.mod(start, self._period)

    def step(self, key: Any, state: jax.Array, lot: State, dt: float) -> jax.Array:
        """Time goes on."""
        del key, lot
        return jnp.mod(state + dt, self._period)

    def obstacles(self, state: jax.Array) -> list[Boxes]:
        """A box for each car of the file."""
        drives = self.drives
        end = jnp.asarray(drives.end)
        there = (state >= drives.time[:, 0]) & (state <= end)
        pose = _at(drives, state)
        moved = (
            _at(drives, state + INSTANT)[:, :2] - _at(drives, state - INSTANT)[:, :2]
        )
        velocity = moved / (2.0 * INSTANT)
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

"""What moves in a scenario, `carpark_mj.suite.scenario`, and what repetitions vary."""

import dataclasses
import itertools
import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import (
    FARTHEST,
    Bounds,
    CheckedConfig,
    Natural,
    NonNegative,
    Positive,
)
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.scripted import Script, Scripted, ScriptedBox, ScriptedPerson

Pose = Annotated[tuple[float, float, float], Bounds(ge=-FARTHEST, le=FARTHEST)]
Pair = tuple[float, float]  # of bounds that do not rise, see `require`
PLACE = Bounds(ge=-FARTHEST, le=FARTHEST, unit="m")
SIZE = Bounds(gt=0.0, le=50.0, unit="m")
HEADING = Bounds(ge=-math.tau, le=math.tau, unit="rad")
SIZES = {"person": (0.5, 0.5), "cart": (1.0, 0.6), "car": (4.5, 1.8)}  # m
BEHIND = 0.5  # m behind the front of a row, where a mover between two bays waits
ACROSS = 8.0  # m that it goes
SLOWEST = 0.01  # m/s or m, least of what a spread makes of speeds and distances
EACH = 6  # numbers that are drawn for each mover


@dataclasses.dataclass(frozen=True)
class Spread(CheckedConfig):
    """Largest deviations of repetitions, uniform.

    Attributes:
        place: of x and of y [m].
        heading: of the start, and of a mover's direction [rad].
        speed: [m/s]; of a path that of `speed`, the others in proportion.
        near: of a mover's distance to a car at which it sets out [m].
        after: of the time after which it sets out [s].
    """

    place: NonNegative = 0.0
    heading: NonNegative = 0.0
    speed: NonNegative = 0.0
    near: NonNegative = 0.0
    after: NonNegative = 0.0


@dataclasses.dataclass(frozen=True)
class Actor(CheckedConfig):
    """What moves in a scenario, once it sets out: straight on, or along a path.

    Without a trigger it sets out at once; of several the first counts. Without `to` and
    `path` it stands.

    Attributes:
        kind: a person is a disc, the others are boxes.
        start: its centre [m].
        to: where it goes [m].
        path: instead of `to`, points [m] to go through, each with the speed on the way
            there [m/s] if that is not `speed`, and the heading there [rad] if that is
            not the direction of travel.
        between: two bays instead of `start` and `to`: it steps out between them.
        heading: of one that stands [rad], or at the start of a path with headings.
        size: length and width, of a person twice the diameter [m]; default: by kind.
        speed: at first [m/s].
        slowing: deceleration [m/s²].
        pause: at the end of the way before it returns [s].
        returns: whether it goes back.
        backwards: whether its rear is ahead.
        near: distance between its centre and the car's at which it sets out [m].
        ahead: distance ahead of the car, along its axis, at which it sets out [m].
        after: time after which it sets out [s].
        yields: whether it waits for a car that cannot stop; otherwise some contacts
            are unavoidable.
        spread: of the repetitions.
    """

    kind: Literal["person", "cart", "car"] = "person"
    start: Pair | None = None
    to: Pair | None = None
    path: tuple[tuple[float, ...], ...] | None = None
    between: tuple[Natural, Natural] | None = None
    heading: Annotated[float, HEADING] | None = None
    size: Pair | None = None
    speed: Positive = 1.0
    slowing: NonNegative = 0.0
    pause: NonNegative = 0.0
    returns: bool = False
    backwards: bool = False
    near: Positive | None = None
    ahead: Positive | None = None
    after: NonNegative | None = None
    yields: bool = True
    spread: Spread = dataclasses.field(default_factory=Spread)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, bounds in (("start", PLACE), ("to", PLACE), ("size", SIZE)):
            require(name, getattr(self, name), bounds)
        given = [x is not None for x in (self.start, self.to, self.path, self.between)]
        if given[0] == given[3] or sum(given[1:]) > 1:
            raise ValueError(
                "a mover needs a start, with to, with path, or with neither if it "
                "stands; or two bays in between"
            )
        for row in self.path or ():
            if len(row) not in (2, 3, 4):
                raise ValueError(f"path must have rows [x, y, speed], not {row}")
            require("a point of path", row[:2], PLACE)
            require(
                "the speed of a point of path", row[2:3], Bounds(gt=0.0, unit="m/s")
            )
            require("the heading of a point of path", row[3:], HEADING)
        headed = {len(row) > 3 for row in self.path or ()}
        if self.path is not None and (self.slowing or len(headed) != 1):
            raise ValueError(
                "a path has points, all with headings or none, and no slowing"
            )
        if not any(given[1:]) and any(x is not None for x in self.triggers):
            raise ValueError("a mover that stands has no trigger")
        if self.heading is not None and any(given[1:]) and headed != {True}:
            raise ValueError("a mover with a way heads along it: leave heading out")
        if any(a == b for a, b in itertools.pairwise(self.points)):
            raise ValueError(f"points of a way must differ, not {self.points}")

    @property
    def triggers(self) -> tuple[float | None, float | None, float | None]:
        """What sets it out."""
        return self.near, self.ahead, self.after

    @property
    def points(self) -> list[Pair]:
        """The points of its way, without those between bays."""
        rows = [self.start, self.to, *(self.path or ())]
        return [(row[0], row[1]) for row in rows if row is not None]

    def script(self, layout: Layout) -> Scripted:
        """The mover in a lot."""
        stands = len(self.points) == 1
        if self.between is None:
            yaw = self.heading or 0.0
            ahead = np.array([math.cos(yaw), math.sin(yaw)])
            start, *others = map(np.array, self.points)
            way = ahead if stands else others[0] - start
        else:
            require_bays("between", self.between, layout)
            pose = np.asarray(layout.bay_pose)[list(self.between)]
            front = np.asarray(layout.bay_size)[self.between[0], 0] / 2 - BEHIND
            ahead = np.array([math.cos(pose[0, 2]), math.sin(pose[0, 2])])
            start, way = pose[:, :2].mean(axis=0) + front * ahead, ACROSS * ahead
        direction = math.atan2(way[1], way[0])
        heading = math.remainder(direction + math.pi * self.backwards, math.tau)
        heading = heading if self.heading is None else self.heading
        made = ScriptedPerson if self.kind == "person" else ScriptedBox
        same = ("speed", "slowing", "pause", "returns", "yields")
        return made(
            **{name: getattr(self, name) for name in same},
            start=(float(start[0]), float(start[1]), heading),
            direction=direction,
            distance=math.hypot(*way),
            trigger=self.ahead or 0.0,
            near=self.near or 0.0,
            after=self.after if stands or any(self.triggers) else 0.0,
            size=self.size or SIZES[self.kind],
            path=tuple(
                (*row, self.speed)[: max(len(row), 3)] for row in self.path or ()
            ),
        )


def varied(script: Script, spread: Spread, chance: np.ndarray) -> Script:
    """Scripts (n,) of one, by `chance` (n, EACH)."""
    x, y, turn, faster, further, later = (column[:, None] for column in chance.T)
    turn = turn * spread.heading
    move = np.concatenate([x * spread.place, y * spread.place, turn], axis=1)

    def moved(value: jax.Array, change: np.ndarray, least: float) -> jax.Array:
        return jnp.where(value > 0.0, jnp.maximum(value + change[:, 0], least), value)

    return dataclasses.replace(
        repeated(script, len(chance)),
        start=script.start + move,
        direction=script.direction + turn[:, 0],
        speed=moved(script.speed, faster * spread.speed, SLOWEST),
        trigger=moved(script.trigger, further * spread.near, SLOWEST),
        near=moved(script.near, further * spread.near, SLOWEST),
        after=jnp.maximum(script.after + later[:, 0] * spread.after, 0.0),
    )


def repeated(tree: Any, count: int) -> Any:
    """The arrays (...) of a tree as (count, ...)."""
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *np.shape(x))), tree)


def require(name: str, value: tuple[float, ...] | float | None, bounds: Bounds) -> None:
    """Refuses a value, or numbers of a tuple, beyond bounds."""
    if value is not None and not bounds.admit(value):
        raise ValueError(f"{name} must {bounds}, not {value}")


def require_bays(name: str, numbers: Iterable[int], layout: Layout) -> None:
    """Refuses numbers that are no bays of a lot."""
    known = np.flatnonzero(layout.bay_mask)
    for number in numbers:
        if number not in known:
            raise ValueError(
                f"{name} must be a bay of the lot, {known[0]} to {known[-1]}, not "
                f"{number}"
            )

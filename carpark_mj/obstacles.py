"""Obstacles: all that agents can hit, see and keep away from, in one list.

Movers move by themselves and belong to a lot.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import CheckedConfig, require_name
from carpark_mj.extensions import Registry
from carpark_mj.geometry import rotate, wrap_angle
from carpark_mj.geometry.obstacles import (
    NO_MOVERS,
    Boxes,
    Discs,
    Group,
    Movers,
    ObstacleKind,
)
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion, ParkedCars, State


class Mover(CheckedConfig, abc.ABC):
    """Base of obstacles that move by themselves, a frozen dataclass of settings.

    Agents must avoid them: contacts do not push them. They push and stop cars in
    physics whose world has them, `scene`.

    Attributes:
        mover: its name in `MOVERS`.
        kind: what its obstacles are.
    """

    mover: str
    kind: ClassVar[ObstacleKind] = ObstacleKind.MOVER

    @abc.abstractmethod
    def init(self, key: jax.Array, layout: Layout) -> Any:
        """Its state in a lot that begins, a pytree of arrays; `key` is consumed."""

    def begin(self, key: jax.Array, layout: Layout, others: Sequence[Group]) -> Any:
        """Its state in a lot that begins, clear of what stands there already.

        `others` are parked cars, walls, and the movers before it. By default the state
        is that of `init`, wherever they are.
        """
        del others
        return self.init(key, layout)

    @abc.abstractmethod
    def step(self, key: jax.Array, state: Any, lot: State, dt: float) -> Any:
        """Its state after a control step, of the same shapes.

        Args:
            key: consumed.
            state: before.
            lot: everything else, before the step. Its movers are the others: those
                before it in the lot's list have already moved.
            dt: control period [s].
        """

    @abc.abstractmethod
    def obstacles(self, state: Any) -> Sequence[Group]:
        """Where it is: groups `Boxes` and `Discs`.

        Their number is constant; masks mark those that exist. Between two steps
        obstacles move along straight lines; new ones appear at their new places.
        """


MOVERS: Registry[Mover] = Registry("mover", "carpark_mj.movers")

# As a flag a mover is its name, as a layout is.
if TYPE_CHECKING:
    MoverChoice = Mover | str
else:
    MoverChoice = str


def make_movers(choices: Sequence[MoverChoice]) -> tuple[Mover, ...]:
    """The movers that names stand for; others as given.

    A name may bring settings, as in `pedestrians:number=20,speed=0.8..1.6`.
    """
    movers = tuple(_named(x) if isinstance(x, str) else x for x in choices)
    for mover in movers:
        if mover.kind == ObstacleKind.AGENT:
            raise ValueError(f"the mover {mover.mover!r} must not be of the kind AGENT")
    return movers


def _named(choice: str) -> Mover:
    """The mover of a name, with the settings that follow it."""
    name, colon, words = choice.partition(":")
    mover: Any = MOVERS[name]
    values: dict[str, str | float | tuple[float, ...]] = {}
    fields = dataclasses.fields(mover)
    known = [field.name for field in fields if field.name != "mover"]
    for word in words.split(",") if colon else ():
        setting, _, value = word.partition("=")
        require_name(f"setting of the mover {name!r}", setting, known)
        if isinstance(getattr(mover, setting), str):
            values[setting] = value
            continue
        numbers = [_number(setting, part) for part in value.split("..")]
        values[setting] = numbers[0] if len(numbers) == 1 else tuple(numbers)
    return dataclasses.replace(mover, **values)


def _number(setting: str, text: str) -> float:
    """A number of a setting; a whole one if it is written so."""
    try:
        return int(text) if text.lstrip("-").isdigit() else float(text)
    except ValueError:
        raise ValueError(
            f"{setting} must be a number, or two with .. between them, not {text!r}"
        ) from None


def hit_kinds(movers: Sequence[MoverChoice]) -> tuple[ObstacleKind, ...]:
    """Kinds of obstacles in a lot with some movers."""
    always = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR, ObstacleKind.WALL)
    return tuple(sorted({*always, *(mover.kind for mover in make_movers(movers))}))


def lot_obstacles(
    layout: Layout,
    motion: Motion | None,
    parked_cars: ParkedCars,
    movers: Movers = NO_MOVERS,
) -> tuple[Group, ...]:
    """All obstacles of a lot, agents first; without them if `motion` is None."""
    agent, car, wall = ObstacleKind.AGENT, ObstacleKind.PARKED_CAR, ObstacleKind.WALL
    groups: list[Group] = []
    if motion is not None:
        velocity_w = rotate(motion.velocity_b, motion.pose_w[..., 2])
        agents = motion.pose_w, motion.size, velocity_w, None, motion.trace_w
        groups.append(Boxes(*agents, kind=agent))
    parked = parked_cars.pose_w, parked_cars.size
    groups.append(Boxes(*parked, mask=parked_cars.present, kind=car))
    walls, discs = layout.wall_mask, layout.disc_mask
    groups.append(Boxes(layout.wall_pose, layout.wall_size, mask=walls, kind=wall))
    groups.append(Discs(layout.disc_centre, layout.disc_radius, mask=discs, kind=wall))
    return (*groups, *movers.groups)


def begin_movers(
    movers: Sequence[Mover],
    layout: Layout,
    key: jax.Array,
    others: Sequence[Group] = (),
) -> Movers:
    """Movers of a lot that begins, not traced yet; `key` is consumed.

    Each keeps clear of the others that stand in the lot and of the movers before it.
    """
    states, others = [], list(others)
    for mover, own_key in zip(movers, jax.random.split(key, len(movers)), strict=True):
        states.append(_strong(mover.begin(own_key, layout, others)))
        others += _groups(mover, states[-1])
    return place_movers(movers, states)


def mover_shapes(movers: Sequence[Mover], layout: Layout) -> tuple[Group, ...]:
    """The groups of movers in lots of a layout: shapes and types instead of arrays."""

    def begin(key: jax.Array) -> Movers:
        return begin_movers(movers, layout, key)

    return jax.eval_shape(begin, jax.random.key(0)).groups


def place_movers(movers: Sequence[Mover], states: Sequence[Any]) -> Movers:
    """Movers in states that their `init` and `step` returned, not traced yet."""
    strong = tuple(map(_strong, states))
    return Movers(strong, tuple(map(_groups, movers, strong)))


def trace_still(movers: Movers, num_traces: int) -> Movers:
    """Movers that stood still at all traced instants of a step."""
    parts = movers.obstacles
    still = tuple(tuple(_trace(x, x, num_traces) for x in groups) for groups in parts)
    return dataclasses.replace(movers, obstacles=still)


def step_movers(
    movers: Sequence[Mover], state: State, dt: float, key: jax.Array
) -> Movers:
    """Movers after a control step of `dt` [s]; `state` is before it, `key` consumed.

    One moves after the other. Each sees where the others are by then, so that none
    moves to where another is.
    """
    if not movers:
        return NO_MOVERS
    old, num_traces = state.movers, state.motion.trace_w.shape[-2]
    keys, states, obstacles = jax.random.split(key, len(movers)), [], [*old.obstacles]
    for number, mover in enumerate(movers):
        before, there = old.states[number], old.obstacles[number]
        others = Movers((), (*obstacles[:number], *obstacles[number + 1 :]))
        lot = dataclasses.replace(state, movers=others)
        after = _strong(mover.step(keys[number], before, lot, dt))
        pairs = zip(there, _groups(mover, after), strict=True)
        states.append(after)
        obstacles[number] = tuple(_trace(*pair, num_traces) for pair in pairs)
    return Movers(tuple(states), tuple(obstacles))


def _groups(mover: Mover, state: Any) -> tuple[Group, ...]:
    """The obstacles of a mover, of its kind."""
    groups = tuple(mover.obstacles(state))
    if not groups or not all(type(group) in (Boxes, Discs) for group in groups):
        raise ValueError(
            f"the obstacles of the mover {mover.mover!r} must be at least one group, "
            f"Boxes or Discs, not {groups!r}"
        )
    for group in groups:
        boxes, n = type(group) is Boxes, jnp.shape(group.pose_w)[:1]
        wanted = {
            "pose_w": (*n, 3 if boxes else 2),
            "size": (*n, 2) if boxes else n,
            "velocity_w": (*n, 2),
            "mask": n,
        }
        for name, shape in wanted.items():
            value = getattr(group, name)
            if value is not None and jnp.shape(value) != shape:
                raise ValueError(
                    f"the mover {mover.mover!r} has {type(group).__name__} whose "
                    f"{name} is of shape {jnp.shape(value)}, not {shape}"
                )
    return tuple(
        _strong(dataclasses.replace(g, trace_w=None, kind=mover.kind)) for g in groups
    )


def _strong(tree: Any) -> Any:
    """Arrays without weak types, as the carry of a loop requires."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.result_type(x)), tree)


def _trace(before: Group, after: Group, num_traces: int) -> Group:
    """Obstacles (n,) with their poses during a step."""
    left = jnp.arange(num_traces - 1, -1, -1, dtype=after.pose_w.dtype) / num_traces
    return dataclasses.replace(after, trace_w=poses_during(before, after, left))


def poses_during(before: Group, after: Group, left: jax.Array) -> jax.Array:
    """Poses (n, k, 3 or 2) of obstacles (n,) within a control step, on straight lines.

    At moments when the shares `left` (k,) of the step are left. Those that were absent
    before stand still, where they are after it.
    """
    moved = after.pose_w - before.pose_w
    if type(after) is Boxes:
        moved = moved.at[:, 2].set(wrap_angle(moved[:, 2]))
    if before.mask is not None:
        moved = jnp.where(before.mask[:, None], moved, 0.0)
    return after.pose_w[:, None] - left[:, None] * moved[:, None]

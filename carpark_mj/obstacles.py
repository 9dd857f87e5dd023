"""Obstacles: all that agents can hit, see and keep away from, in one list.

Movers move by themselves and belong to a lot.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config.obstacles import Mover, ObstacleKind
from carpark_mj.geometry import rotate, wrap_angle
from carpark_mj.geometry.obstacles import NO_MOVERS, Boxes, Discs, Group, Movers
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Motion, ParkedCars, State

__all__ = [
    "Boxes",
    "Discs",
    "Group",
    "begin_movers",
    "lot_obstacles",
    "mover_shapes",
    "place_movers",
    "poses_during",
    "step_movers",
    "trace_still",
]


def lot_obstacles(
    layout: Layout,
    motion: Motion | None,
    parked_cars: ParkedCars,
    movers: Movers = NO_MOVERS,
) -> tuple[Group, ...]:
    """All obstacles of a lot, agents first.

    Args:
        layout: its walls and discs.
        motion: the agents; None = leave them out.
        parked_cars: where they stand.
        movers: where they are.
    """
    groups: list[Group] = []
    if motion is not None:
        velocity_w = rotate(motion.velocity_b, motion.pose_w[..., 2])
        agents = Boxes(motion.pose_w, motion.size, velocity_w, None, motion.trace_w)
        groups.append(dataclasses.replace(agents, kind=ObstacleKind.AGENT))
    parked = Boxes(parked_cars.pose_w, parked_cars.size, mask=parked_cars.present)
    walls = Boxes(layout.wall_pose, layout.wall_size, mask=layout.wall_mask)
    discs = Discs(layout.disc_centre, layout.disc_radius, mask=layout.disc_mask)
    groups.append(dataclasses.replace(parked, kind=ObstacleKind.PARKED_CAR))
    groups += [dataclasses.replace(x, kind=ObstacleKind.WALL) for x in (walls, discs)]
    return (*groups, *movers.groups)


def begin_movers(
    movers: Sequence[Mover],
    layout: Layout,
    key: jax.Array,
    others: Sequence[Group] = (),
) -> Movers:
    """Movers of a lot that begins, not traced yet.

    Each keeps clear of the others and of the movers before it.

    Args:
        movers: which.
        layout: the lot.
        key: consumed.
        others: what stands in the lot.
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
    still = tuple(
        tuple(_trace(group, group, num_traces) for group in groups)
        for groups in movers.obstacles
    )
    return dataclasses.replace(movers, obstacles=still)


def step_movers(
    movers: Sequence[Mover], state: State, dt: float, key: jax.Array
) -> Movers:
    """Movers after a control step.

    One moves after the other. Each sees where the others are by then, so that none
    moves to where another is.

    Args:
        movers: which.
        state: of the lot before the step.
        dt: control period [s].
        key: consumed.
    """
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
    """Poses (n, k, 3 or 2) of obstacles within a control step, on straight lines.

    Those that were absent before stand still, where they are after it.

    Args:
        before: (n,) at its start.
        after: (n,) at its end.
        left: (k,) shares of the step that are left.
    """
    moved = after.pose_w - before.pose_w
    if type(after) is Boxes:
        moved = moved.at[:, 2].set(wrap_angle(moved[:, 2]))
    if before.mask is not None:
        moved = jnp.where(before.mask[:, None], moved, 0.0)
    return after.pose_w[:, None] - left[:, None] * moved[:, None]

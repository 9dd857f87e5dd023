"""The interface between physics and task, and shared code of back ends.

Every function takes any leading batch shape, except the steps of `ScenePhysics`.
"""

import abc
import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.config import PhysicsConfig, SimConfig
from carpark_mj.config.checks import require_unset
from carpark_mj.geometry.obstacles import Group
from carpark_mj.types import Motion, PhysicsState, State
from carpark_mj.vehicle.vehicle import Vehicle

S = TypeVar("S", bound=PhysicsState)
Tree = TypeVar("Tree")
Cars = TypeVar("Cars", bound=Any)  # a dataclass with `trace_w` and `finite`


class Physics(abc.ABC, Generic[S]):
    """A physics back end, by default with a world of its own for every car.

    Then cars meet only in the task, which detects collisions with exact box tests, and
    parked cars stay where they were set. Poses (..., 3) are of the footprints' centres
    [m, m, rad], and vehicles have the leading shape of the cars.

    Attributes:
        config: its traits. With `contacts`, `read` reports the contacts of cars.
    """

    config: PhysicsConfig

    @abc.abstractmethod
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> S:
        """Cars at rest at poses (..., 3)."""

    @abc.abstractmethod
    def step(self, state: S, controls: jax.Array) -> S:
        """Advances by one control step.

        `controls` (..., k) as of `PhysicsConfig`: of cars steer and pedal in [-1, 1].
        """

    @abc.abstractmethod
    def read(self, state: S) -> Motion:
        """The motion of the cars; the task reads nothing else."""

    def place(
        self, state: S, mask: jax.Array, pose_w: jax.Array, vehicle: Vehicle
    ) -> S:
        """Places cars of a mask (...) at poses (..., 3), at rest, and no others."""
        return where_cars(mask, self.init(pose_w, vehicle), state)

    def set_parked_poses(self, state: S, parked_pose: jax.Array) -> S:
        """Sets the poses (..., num_parked_cars, 3) of parked cars' footprints.

        It is called at the start and when a parked car is relocated.
        """
        return state

    def parked_poses(self, state: S, intended: jax.Array) -> jax.Array:
        """The current poses (..., num_parked_cars, 3) of parked cars' footprints.

        `intended` are those that were set; contacts may have pushed the cars elsewhere.
        """
        return intended

    def set_speed(self, state: S, speed: jax.Array) -> S:
        """Cars (...) as they stand, rolling straight on at speeds (...) [m/s].

        For `ResetOptions.speed`; not all back ends can.
        """
        name = type(self).__name__
        raise ValueError(f"options.speed needs physics with set_speed, not {name}")

    def halt(self, state: S, mask: jax.Array, trace_w: jax.Array) -> S:
        """Stops cars of a mask (...) dead, their steering as it is, and no others.

        In the control step that ends they were at `trace_w` (..., k, 3) instead, and
        stand at its end. For `EpisodeConfig.kerb_speed`; not all back ends can.
        """
        raise NotImplementedError

    @property
    def can_halt(self) -> bool:
        """Whether obstacles can stop its cars, by `halt`."""
        return type(self).halt is not Physics.halt

    def step_among(
        self,
        state: S,
        controls: jax.Array,
        before: Sequence[Group],
        after: Sequence[Group],
    ) -> S:
        """Advances one lot by one control step, from movers `before` to those `after`.

        Where movers are bodies, which stop and push cars, their contacts are columns of
        `Motion.touched`; by default they are none.
        """
        return self.step(state, controls)


def where_cars(mask: jax.Array, new: Tree, old: Tree) -> Tree:
    """Takes cars from the tree `new` where `mask` (...) is true, else from `old`."""

    def select(a: jax.Array, b: jax.Array) -> jax.Array:
        if a is b:  # what neither changed
            return a
        return jnp.where(jnp.expand_dims(mask, range(mask.ndim, b.ndim)), a, b)

    return jax.tree.map(select, new, old)


def freeze(
    state: State, physics: PhysicsState, motion: Motion
) -> tuple[PhysicsState, Motion]:
    """Keeps agents that are not active exactly where they stand, at rest."""
    physics = where_cars(state.active, physics, state.physics)
    rest = dataclasses.replace(
        state.motion,
        velocity_b=jnp.zeros_like(state.motion.velocity_b),
        yaw_rate=jnp.zeros_like(state.motion.yaw_rate),
    )
    motion = where_cars(state.active, motion, rest)
    still = jnp.broadcast_to(motion.pose_w[:, None], motion.trace_w.shape)
    trace_w = where_cars(state.active, motion.trace_w, still)
    return physics, dataclasses.replace(motion, trace_w=trace_w)


def contain_non_finite(
    before: Cars,
    moved: dict[str, Any],
    still: dict[str, jax.Array],
    valid: jax.Array | bool = True,
) -> Cars:
    """Cars (...) after a step; those with a non-finite number affect no other.

    The step computed the fields `moved`, the last `trace_w`. Such cars, and those that
    are not `valid` (...), are put back with the fields `still`, and flagged.
    """
    lead = before.finite.ndim
    checks = [
        jnp.all(jnp.isfinite(x), axis=tuple(range(lead, x.ndim)))
        for x in jax.tree.leaves(list(moved.values()))
    ]
    stepped = dataclasses.replace(before, **moved, finite=jnp.ones_like(before.finite))
    at_rest = dataclasses.replace(
        before,
        **still,
        trace_w=jnp.broadcast_to(before.trace_w[..., -1:, :], before.trace_w.shape),
        finite=jnp.zeros_like(before.finite),
    )
    return where_cars(jnp.stack(checks).all(axis=0) & valid, stepped, at_rest)


def run_substeps(
    sim: SimConfig,
    substep: Callable[[Tree], Tree],
    carry: Tree,
    pose: Callable[[Tree], jax.Array],
) -> tuple[Tree, jax.Array]:
    """Runs the substeps of one control step.

    Returns:
        The carry at the end, and what `pose` has of it, (num_traces, ...), at equally
        spaced instants, the last at the end.
    """
    stride = sim.num_substeps // sim.num_traces
    # A gradient stores only the carry and recomputes the rest: it takes less memory,
    # and half as long to compile.
    substep = jax.checkpoint(substep, prevent_cse=False)

    def stretch(carry: Tree, _: None) -> tuple[Tree, jax.Array]:
        carry, _ = jax.lax.scan(lambda c, _: (substep(c), None), carry, length=stride)
        return carry, pose(carry)

    return jax.lax.scan(stretch, carry, length=sim.num_traces)


def require_plain_ground(sim: SimConfig, name: str) -> None:
    """Refuses settings of ground, tyres and real cars for a kinematic back end."""
    names = ("grade_x", "ramp", "surface", "tyres")
    late = ("steering_delay", "pedal_delay", "creep")
    require_unset(sim, f"in {name} physics, which has no tyres", *names, *late)

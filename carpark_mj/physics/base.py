"""The interface between physics and task, and shared code of back ends.

Every function takes any leading batch shape, except the steps of `ScenePhysics`.
"""

import abc
from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, PhysicsConfig, SimConfig
from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts import Layout
from carpark_mj.types import Motion, PhysicsState
from carpark_mj.vehicle import VehicleParameters
from carpark_mj.vehicle.vehicle import Vehicle

S = TypeVar("S", bound=PhysicsState)
Tree = TypeVar("Tree")


class Physics(abc.ABC, Generic[S]):
    """A physics back end.

    Attributes:
        config: its traits. With `contacts`, `read` reports the contacts of cars.
    """

    config: PhysicsConfig

    @abc.abstractmethod
    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> S:
        """Cars at rest.

        Args:
            pose_w: (..., 3) poses of the footprints' centres [m, m, rad].
            vehicle: parameters with the same leading shape.
        """

    @abc.abstractmethod
    def step(self, state: S, controls: jax.Array) -> S:
        """Advances by one control step.

        Args:
            state: current state.
            controls: (..., k) those of `PhysicsConfig`: steer and pedal in [-1, 1] of
                cars.
        """

    @abc.abstractmethod
    def read(self, state: S) -> Motion:
        """The motion of the cars; the task reads nothing else."""

    @abc.abstractmethod
    def place(
        self, state: S, mask: jax.Array, pose_w: jax.Array, vehicle: Vehicle
    ) -> S:
        """Places cars of a mask (...) at poses (..., 3), at rest, and no others.

        Args:
            state: current state.
            mask: (...) bool, which cars.
            pose_w: (..., 3) poses of the footprints' centres [m, m, rad].
            vehicle: parameters (...) of the cars placed.
        """

    @abc.abstractmethod
    def set_parked_poses(self, state: S, parked_pose: jax.Array) -> S:
        """Sets the poses (..., num_parked_cars, 3) of parked cars' footprints.

        It is called at the start and when a parked car is relocated.
        """

    @abc.abstractmethod
    def parked_poses(self, state: S, intended: jax.Array) -> jax.Array:
        """The current poses (..., num_parked_cars, 3) of parked cars' footprints.

        Args:
            state: current state.
            intended: poses that were set; contacts may have pushed the cars elsewhere.
        """

    def set_speed(self, state: S, speed: jax.Array) -> S:
        """Cars (...) as they stand, rolling straight on at speeds (...) [m/s].

        For `ResetOptions.speed`; not all back ends can.
        """
        name = type(self).__name__
        raise ValueError(f"options.speed needs physics with set_speed, not {name}")

    def halt(self, state: S, mask: jax.Array, trace_w: jax.Array) -> S:
        """Stops some cars dead, their steering as it is, and leaves the others alone.

        For `EpisodeConfig.kerb_speed`; not all back ends can.

        Args:
            state: at the end of a control step.
            mask: (...) bool, which cars.
            trace_w: (..., k, 3) where they were in the step instead, and stand at its
                end.
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
        """Advances one lot by one control step, in which movers move too.

        Where movers are bodies, which stop and push cars, their contacts are columns of
        `Motion.touched`; by default they are none.

        Args:
            state: current state.
            controls: see `step`.
            before: where movers are at the start of the step.
            after: where they are at its end.
        """
        del before, after
        return self.step(state, controls)


class FactoredPhysics(Physics[S]):
    """Base of back ends in which every car has a world of its own.

    Cars meet only in the task layer, which detects collisions with exact box tests;
    parked cars stay where they were set.
    """

    def place(
        self, state: S, mask: jax.Array, pose_w: jax.Array, vehicle: Vehicle
    ) -> S:
        """Places some cars at new poses, at rest; see `Physics.place`."""
        return where_cars(mask, self.init(pose_w, vehicle), state)

    def set_parked_poses(self, state: S, parked_pose: jax.Array) -> S:
        """Returns the state, which has no parked cars."""
        del parked_pose
        return state

    def parked_poses(self, state: S, intended: jax.Array) -> jax.Array:
        """Returns the intended poses: parked cars cannot be pushed."""
        del state
        return intended


def where_cars(mask: jax.Array, new: Tree, old: Tree) -> Tree:
    """Takes cars from the tree `new` where `mask` (...) is true, else from `old`."""

    def select(a: jax.Array, b: jax.Array) -> jax.Array:
        if a is b:  # what neither changed
            return a
        return jnp.where(jnp.expand_dims(mask, range(mask.ndim, a.ndim)), a, b)

    return jax.tree.map(select, new, old)


class _Flagged(Protocol):
    @property
    def finite(self) -> jax.Array: ...


Cars = TypeVar("Cars", bound=_Flagged)


def contain_non_finite(
    moved: Any, stepped: Cars, at_rest: Cars, valid: jax.Array | bool = True
) -> Cars:
    """Replaces cars with a non-finite number, so that they affect no other.

    Args:
        moved: tree of arrays (..., *) that the step computed.
        stepped: cars (...) after the step, `finite` all true.
        at_rest: cars (...) at their poses before it, `finite` all false.
        valid: (...) bool, cars that need not be replaced for another reason.
    """
    lead = stepped.finite.ndim
    checks = [
        jnp.all(jnp.isfinite(x), axis=tuple(range(lead, x.ndim)))
        for x in jax.tree.leaves(moved)
    ]
    return where_cars(jnp.stack(checks).all(axis=0) & valid, stepped, at_rest)


def run_substeps(
    sim: SimConfig,
    substep: Callable[[Tree], Tree],
    carry: Tree,
    pose: Callable[[Tree], jax.Array],
) -> tuple[Tree, jax.Array]:
    """Runs the substeps of one control step.

    Args:
        sim: time steps.
        substep: advances the carry by one substep.
        carry: variables that the substeps change.
        pose: poses of the carry.

    Returns:
        The carry at the end, and the poses (num_traces, ...) at `num_traces` equally
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
    """Refuses settings that a kinematic back end does not model.

    Raises:
        ValueError: a slope or ramp, a slippery surface, contact tyres, delays or creep.
    """
    plain = {
        "grade_x": 0.0,
        "ramp": (0.0, 0.0, 0.0),
        "surface": "dry",
        "tyres": "brush",
        "steering_delay": 0.0,
        "pedal_delay": 0.0,
        "creep": 0.0,
    }
    for setting, default in plain.items():
        value = getattr(sim, setting)
        if value != default:
            raise ValueError(
                f"{name} physics has no tyres, no options of real cars and no ground: "
                f"{setting} must stay {default!r}, not {value!r}"
            )


def make_physics(
    config: EnvConfig, layout: Layout | None, vehicle: VehicleParameters
) -> Physics[PhysicsState]:
    """Builds the back end of an environment.

    Args:
        config: the environment.
        layout: its lot; None if that is random.
        vehicle: of all cars, for `scene`.

    Raises:
        ValueError: the back end does not support other settings.
        TypeError: its config does not make a back end.
    """
    return require_physics(config.physics_config.make(config, layout, vehicle))


def require_physics(physics: Any) -> Physics[PhysicsState]:
    """Refuses an object that is not a back end.

    Raises:
        TypeError: it is a name, or of another class.
    """
    if not isinstance(physics, Physics):
        raise TypeError(
            "physics must be a carpark_mj.physics.base.Physics or None, not "
            f"{physics!r}: names belong in the config"
        )
    return physics

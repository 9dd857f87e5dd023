"""State of a lot, and the results of a step. All are pytrees.

Suffix `_w` marks the world frame, `_b` the body frame of the car (x forward, y left).
Units are SI and radians; poses are (x [m], y [m], yaw [rad]) of a footprint's centre.
Floats are float32.
"""

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry.obstacles import NO_MOVERS, Movers
from carpark_mj.layouts.routes import Routes
from carpark_mj.layouts.types import Layout

if TYPE_CHECKING:  # it loads MuJoCo, which the task does without
    from carpark_mj.vehicle.vehicle import Vehicle
else:
    Vehicle = Any

# Index of no bay, whatever the layout: as a goal the agent is exploring, as the bay of
# a parked car the car is absent, in a list of tracked bays the slot is empty. Reading
# `array[NO_BAY]` gives the last row, writing `array.at[NO_BAY]` writes nothing.
NO_BAY = 2**31 - 1

Tree = TypeVar("Tree")


@struct.dataclass
class Motion:
    """Motion of the cars, as the task reads it; any leading batch shape `(...)`.

    Attributes:
        pose_w: (..., 3) yaw in [-pi, pi).
        velocity_b: (..., 2) velocity of the rear-axle centre, forward and left [m/s].
        yaw_rate: (...) [rad/s], counter-clockwise positive.
        steering: (...) commanded angle of the bicycle model's wheel [rad], left > 0.
        size: (..., 2) length and width of the footprint [m].
        trace_w: (..., k, 3) poses at k equally spaced instants of the last control
            step, at most `SimConfig.trace_dt` apart; the last equals `pose_w`.
        finite: (...) bool; False where the physics produced a non-finite number in
            the last step, or the car came to lie on its side, and was put back to its
            last state before.
        touched: (..., k) bool, whether the car touched an obstacle at any substep of
            the last step: another agent, a parked car, a wall, and where movers are
            bodies those too, in the order of `ObstacleKind`; None where the physics has
            no contacts and the task finds them by box tests.
    """

    pose_w: jax.Array
    velocity_b: jax.Array
    yaw_rate: jax.Array
    steering: jax.Array
    size: jax.Array
    trace_w: jax.Array
    finite: jax.Array
    touched: jax.Array | None = None

    @property
    def speed(self) -> jax.Array:
        """(...) signed speed along the car's axis [m/s]."""
        return self.velocity_b[..., 0]

    @property
    def xy(self) -> jax.Array:
        """(..., 2) centres [m]."""
        return self.pose_w[..., :2]


class PhysicsState(Protocol):
    """State of a physics back end, a pytree of which the task reads the parameters."""

    @property
    def vehicle(self) -> Vehicle:
        """Parameters of the agents' cars (..., num_agents)."""
        ...


@struct.dataclass
class ParkedCars:
    """The parked cars of a lot.

    Attributes:
        bay: (num_parked_cars,) int32, distinct; `NO_BAY` if a car is absent.
        pose_w: (num_parked_cars, 3) where each stands: in its bay, where it has been
            pushed in physics with contacts, or far away if it is absent.
        size: (num_parked_cars, 2) footprints [m].
        offset: (num_parked_cars, 3) where they stand in their bays if these allow it,
            bay frame; None while all stand in the middle.
        kind: (num_parked_cars,) int32 which of `Fleet.parked_cars` each is; None where
            there is one kind.
    """

    bay: jax.Array
    pose_w: jax.Array
    size: jax.Array
    offset: jax.Array | None = None
    kind: jax.Array | None = None

    @property
    def present(self) -> jax.Array:
        """(num_parked_cars,) bool."""
        return self.bay != NO_BAY


@struct.dataclass
class Reading:
    """Measured motion of cars (...), as in `Motion`."""

    pose_w: jax.Array
    velocity_b: jax.Array
    yaw_rate: jax.Array
    steering: jax.Array


@struct.dataclass
class Odometry:
    """Dead reckoning of cars (...)."""

    pose_w: jax.Array  # (..., 3) where each believes to be
    # (..., 3) of the episode: of the distance [m/m], of the heading per distance
    # [rad/m] and per turn [rad/rad]
    error: jax.Array


@struct.dataclass
class Sensors:
    """Sensors of the agents of a lot."""

    history: Reading  # (num_agents, delay_max + 1, ...), newest first
    delay: jax.Array  # (num_agents,) int32 control steps by which they are late
    odometry: Odometry | None = None  # None where poses are measured


@struct.dataclass
class EpisodeStats:
    """Statistics of the running episodes; all (num_agents,) float32."""

    episode_return: jax.Array  # sum of rewards, undiscounted
    length: jax.Array  # control steps
    path: jax.Array  # driven length [m]
    gear_changes: jax.Array  # times the direction of travel changed
    direction: jax.Array  # sign of the last motion, 0 before the first
    invalid_actions: jax.Array  # steps whose action was NaN or out of range
    # of the path, driven against the lanes [m]; None in lots that never have lanes
    wrong_way: jax.Array | None
    tallies: dict[str, jax.Array]  # all others by name, see `carpark_mj.mdp.metrics`


@struct.dataclass
class State:
    """Everything about one lot at one time.

    Attributes:
        physics: state of the back end, (num_agents,) cars.
        motion: the agents' motion, read from it.
        goal: (num_agents,) int32 the bay each agent heads for; `NO_BAY` while it is
            exploring, or if the lot has no such agent. Fixed goals are distinct.
        tracked_bays: (num_agents, num_tracked_bays) int32 free bays each agent tracks,
            `NO_BAY` in empty slots; None while goals are fixed.
        memory: past observed by agents, a pytree of arrays (num_agents, ...), see
            `ObservationConfig.init_memory`; without any if they do not observe it.
        step: (num_agents,) int32 control steps made in the running episodes.
        active: (num_agents,) bool; False for absent agents and, without respawn, for
            agents that have finished.
        sensors: None while agents observe the true motion.
        key: randomness of this lot.
        present: (num_agents,) bool, the agents that are in the lot; None = always all.
            Absent agents are not active and stand far away.
        waited: (num_agents,) int32 control steps for which an absent agent has waited
            for a free start; 0 = it does not wait. None where no agent ever does.
        routes: None where nothing reads them.
        kind: (num_agents,) int32 which of `Fleet.agents` each drives; None if one.
        movers: obstacles that move by themselves.
    """

    physics: PhysicsState
    motion: Motion
    layout: Layout
    goal: jax.Array
    tracked_bays: jax.Array | None
    parked_cars: ParkedCars
    memory: Any
    step: jax.Array
    active: jax.Array
    stats: EpisodeStats
    sensors: Sensors | None
    key: jax.Array
    present: jax.Array | None = None
    waited: jax.Array | None = None
    routes: Routes | None = None
    kind: jax.Array | None = None
    movers: Movers = NO_MOVERS

    @property
    def exploring(self) -> jax.Array:
        """(num_agents,) bool, has no goal."""
        return self.goal == NO_BAY

    @property
    def takes_part(self) -> jax.Array:
        """(num_agents,) bool, the agents of the lot: present or waiting."""
        if self.present is None:
            return jnp.ones(self.goal.shape, bool)
        return self.present if self.waited is None else self.present | (self.waited > 0)


# How an episode ends; exactly one of these `Events` is true then.
OUTCOMES = ("parked", "crashed", "timed_out")
ENDINGS = (*OUTCOMES, "diverged")


@struct.dataclass
class Events:
    """How each agent's episode stands after a step; all (num_agents,) bool.

    `parked`, `crashed`, `timed_out` and `diverged` exclude each other; together they
    are `done`. The `hit_*` flags name the obstacles that a crashed agent touched
    (several can hold), one for each `ObstacleKind`; None where the lot has none.
    """

    parked: jax.Array
    crashed: jax.Array
    timed_out: jax.Array
    diverged: jax.Array
    hit_agent: jax.Array
    hit_parked_car: jax.Array
    hit_wall: jax.Array
    hit_mover: jax.Array | None = None
    hit_person: jax.Array | None = None
    hit_driver: jax.Array | None = None

    @property
    def success(self) -> jax.Array:
        """(num_agents,) the agent has reached its goal: parked."""
        return self.parked

    @property
    def done(self) -> jax.Array:
        """(num_agents,) the agent's episode has ended."""
        return self.parked | self.crashed | self.timed_out | self.diverged


@struct.dataclass
class GoalEvents:
    """What happened to dynamic goals in a step; all (num_agents,) bool.

    Exactly one of the first five, which the agent chose, holds for an active agent. The
    next two exclude each other and come after the choice: the goal is no longer among
    the tracked bays, or another agent has parked there. `contexts` are situations in
    which the agent should give way, by name; see `carpark_mj.mdp.goals`.
    """

    continue_explore: jax.Array
    stop_explore: jax.Array
    continue_goal: jax.Array
    change_goal: jax.Array
    stop_goal: jax.Array
    lost_untracked: jax.Array
    lost_taken: jax.Array
    contexts: dict[str, jax.Array]

    @property
    def exploring(self) -> jax.Array:
        """(num_agents,) has no goal during the step."""
        return self.continue_explore | self.stop_goal


@struct.dataclass
class Transition:
    """One control step of a lot: what rewards, metrics and new episodes read.

    Attributes:
        after: the state at its end: goals are those chosen, cars have moved; no goal is
            lost, no parked car relocated and no new episode begun yet.
        target_pose: (num_agents, 3) poses of the goals held during the step; of an
            exploring agent that of the nearest bay it tracked.
        goal_events: None while goals are fixed.
        wrong_way: (num_agents,) bool, drives against lanes; None in lots without any.
        invalid_action: (num_agents,) bool, the action was NaN or out of range.
        one_way: (num_agents,) bool, whether only the heading of `target_pose` is right,
            not its opposite; None in lots without such bays.
        braked: (num_agents,) bool, automatic brakes overrode the driver; None of cars
            without such brakes.
    """

    before: State
    after: State
    target_pose: jax.Array
    events: Events
    goal_events: GoalEvents | None
    wrong_way: jax.Array | None
    invalid_action: jax.Array
    one_way: jax.Array | None = None
    braked: jax.Array | None = None

    @property
    def goal(self) -> jax.Array:
        """(num_agents,) int32 goals held during the step."""
        return self.after.goal


@struct.dataclass
class TimeStep:
    """Result of a step for the agents; all with leading dimension (num_agents,).

    Attributes:
        observation: (num_agents, observation_size); where respawned, the new episode's.
        terminated: (num_agents,) bool, parked or crashed: do not bootstrap.
        truncated: (num_agents,) bool, timed out or diverged: bootstrap from
            `final_observation`.
        metrics: per-episode numbers, valid where `events.done`.
        motion: at the end of the step, before any respawn.
        goal: (num_agents,) int32 goals held during the step.
        goal_events: None while goals are fixed.
        final_observation: (num_agents, observation_size) at the end of the step, before
            any respawn or relocation, of agents that are done; meaningless for the
            others; None unless `EpisodeConfig.final_observation`.
    """

    observation: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    events: Events
    metrics: dict[str, jax.Array]
    reward_terms: dict[str, jax.Array]
    motion: Motion
    goal: jax.Array
    goal_events: GoalEvents | None = None
    target_pose: jax.Array | None = None
    final_observation: jax.Array | None = None


def without_empty(tree: Any) -> Any:
    """The tree with None for arrays without elements, which Orbax refuses to save."""
    return jax.tree.map(lambda x: x if x.size else None, tree)


def with_empty(saved: Any, like: Tree) -> Tree:
    """Undoes `without_empty`; `like` has the shapes, as `jax.eval_shape` gives."""

    def fill(shape: Any, x: Any) -> Any:
        return x if shape.size else jnp.zeros(shape.shape, shape.dtype)

    return jax.tree.map(fill, like, saved)

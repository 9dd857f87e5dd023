"""Goals: which bay an agent heads for; docs/dynamic_goals.md has more.

Fixed goals are drawn for each episode (`carpark_mj.spawning.goals`). Dynamic goals are
chosen by the agents at the start of every step: to explore, or to head for one of the
nearest free bays, which they track. A bay is free if it holds no parked car, even if it
is another agent's goal or an agent is in it (Tanner 2022).

*Giving way*: an agent with a goal is in a context of `CONTEXTS` if another agent is
strictly nearer to that goal (centres, world distance), and is tracked or has the same
goal. Poses and tracked agents are those at the start of the step. Agents choose in the
order of their numbers, as in the study: each sees the new goals of agents before it and
the old goals of agents after it. All cars move after the last choice.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Bounds, CheckedConfig, Count, data
from carpark_mj.geometry import nearest, norm
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.parked_cars import bay_fits, free_bays
from carpark_mj.types import NO_BAY, Events, GoalEvents, State

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig

Scheme = Literal["L,L,S", "L,L,A", "G,L,S", "G,L,A", "G,G,S", "G,G,A"]
CONTEXTS = (
    *("local_same", "local_any", "global_same", "global_any"),
    *("untracked_same", "untracked_any", "untracked_other"),
    *("only_untracked_same", "only_untracked_any", "global_same_not_local_any"),
)


@dataclasses.dataclass(frozen=True)
class GoalConfig(CheckedConfig):
    """How agents get their goals.

    Attributes:
        dynamic: every agent chooses its goal at every step among the free bays it
            tracks; otherwise the environment draws one for each episode.
        num_tracked_bays: nearest free bays that an agent tracks (n_space).
        slots_by_distance: sort the tracked bays by distance at every step; otherwise a
            bay keeps its slot while it is tracked.
        may_repeat: whether an episode may have the goal of the agent's last episode;
            fixed goals only.
        drive_out: an agent that starts in a bay drives to an exit of the lot, all
            others to bays; fixed goals only, in layouts with exits.
    """

    dynamic: bool = False
    num_tracked_bays: Count = 1
    slots_by_distance: bool = False
    may_repeat: bool = False
    drive_out: bool = False


@dataclasses.dataclass(frozen=True)
class GivingWayConfig(CheckedConfig):
    """Asks agents to give up goals that another agent is nearer to.

    A scheme (a, b, c) of Tanner 2022 is written "a,b,c". With a = G the
    agents see global information about the bays they track, with L they do not. (b, c)
    is the enforced context: a goal is bad if another agent is nearer to it that is
    tracked (b = L) or anywhere (b = G), and has the same goal (c = S) or any (c = A).

    Attributes:
        scheme: None = no context is enforced. Needs dynamic goals.
        bad_goal: reward for keeping a bad goal, in place of `continue_goal`; at most 0.
            The study sweeps 0 to -0.2.
    """

    scheme: Scheme | None = None
    bad_goal: Annotated[float, Bounds(le=0.0)] = data(0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scheme is None and self.bad_goal:
            raise ValueError(
                f"bad_goal {self.bad_goal} needs a scheme, one of "
                f"{sorted(get_args(Scheme))}"
            )

    @property
    def global_information(self) -> bool:
        """Whether the scheme shows the agents global information."""
        return self.scheme is not None and self.scheme.startswith("G")

    @property
    def context(self) -> str | None:
        """The context in which keeping the goal is bad; None if none is enforced."""
        if self.scheme is None:
            return None
        _, where, goal = self.scheme.split(",")
        return {"L": "local", "G": "global"}[where] + {"S": "_same", "A": "_any"}[goal]


def init_tracked_bays(config: EnvConfig) -> jax.Array | None:
    """Empty slots (num_agents, num_tracked_bays) int32; None if goals are fixed."""
    shape = config.num_agents, config.goals.num_tracked_bays
    return jnp.full(shape, NO_BAY, jnp.int32) if config.goals.dynamic else None


def choose_goals(config: EnvConfig, state: State, choice: jax.Array | None) -> State:
    """The state with goals as active agents (num_agents,) choose them.

    `choice` is 0 = explore, k = the bay in slot k - 1; an empty slot, and any other
    number, keeps the goal. None if goals are fixed.
    """
    if not config.goals.dynamic:
        return state
    tracked, goal = state.tracked_bays, state.goal
    assert choice is not None
    assert tracked is not None
    number = jnp.arange(1, tracked.shape[1] + 1)
    here = (choice[:, None] == number) & (tracked != NO_BAY)
    chosen = jnp.min(jnp.where(here, tracked, NO_BAY), axis=1)
    chosen = jnp.where(here.any(axis=1), chosen, goal)
    chosen = jnp.where(choice == 0, NO_BAY, chosen).astype(jnp.int32)
    return dataclasses.replace(state, goal=jnp.where(state.active, chosen, goal))


def possible_choices(state: State) -> jax.Array | None:
    """Choices that do something (..., num_agents, 1 + num_tracked_bays) bool.

    To explore, and to head for a bay in a slot that is not empty; None if goals are
    fixed, as in states of other tasks.
    """
    tracked = getattr(state, "tracked_bays", None)
    if tracked is None:
        return None
    return jnp.concatenate([jnp.ones_like(tracked[..., :1]), tracked != NO_BAY], -1) > 0


def target_bays(state: State) -> jax.Array:
    """The bay that each agent (num_agents,) heads for; `Transition.target_pose`."""
    if state.tracked_bays is None:
        return state.goal
    return target_bay(state.layout, state.goal, state.tracked_bays, state.motion.xy)[0]


def target_bay(
    layout: Layout, goal: jax.Array, tracked_bays: jax.Array, xy: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Each agent's goal or, while it explores, the nearest bay it tracks.

    Goals are (num_agents,) int32, tracked bays (num_agents, num_tracked_bays) int32,
    and centres (num_agents, 2) [m]. Returns (num_agents,) int32, and (num_agents,)
    bool, whether the bay exists.
    """
    rows = jnp.minimum(tracked_bays, layout.num_bays - 1)
    gap = norm(layout.bay_pose[rows, :2] - xy[:, None])
    rank = jnp.argmin(jnp.where(tracked_bays != NO_BAY, gap, jnp.inf), axis=1)
    near = jnp.take_along_axis(tracked_bays, rank[:, None], axis=1)[:, 0]
    bay = jnp.where(goal != NO_BAY, goal, near)
    return jnp.minimum(bay, layout.num_bays - 1), bay != NO_BAY


def update_goals(
    config: EnvConfig, before: State, after: State, events: Events
) -> tuple[State, GoalEvents | None]:
    """Drops lost goals and updates tracked bays at the end of a step.

    Goals are not chosen yet in `before`, and chosen in `after`, where parked cars are
    relocated. Returns the state, and what happened to goals, all False for agents that
    had finished; None if goals are fixed.
    """
    if not config.goals.dynamic:
        return after, None
    goal = after.goal
    same = (goal[:, None] == goal) & ~jnp.eye(goal.shape[0], dtype=bool)
    taken = (same & events.parked).any(axis=1) & ~events.done
    # Where finished agents stay, those that have parked stand in their bays.
    respawn = config.episode.respawn
    leaves = events.done if respawn else events.done & ~events.parked
    kept = jnp.where(taken | leaves, NO_BAY, after.goal)
    state = dataclasses.replace(after, goal=kept)
    tracking = track_bays(config, state)
    old, chosen, active = before.goal, after.goal, before.active
    had, has = active & (old != NO_BAY), active & (chosen != NO_BAY)
    return tracking, GoalEvents(
        continue_explore=active & ~had & ~has,
        stop_explore=~had & has,
        continue_goal=had & has & (old == chosen),
        change_goal=had & has & (old != chosen),
        stop_goal=had & ~has,
        lost_untracked=state.goal != tracking.goal,
        lost_taken=taken,
        contexts=find_contexts(before, chosen, tracks(config, before)),
    )


def track_bays(config: EnvConfig, state: State) -> State:
    """The state with tracked bays up to date, and goals not among them lost.

    Agents that have finished occupy their goals. Fixed goals leave the state as it is.
    """
    if state.tracked_bays is None:
        return state
    layout, goal = state.layout, state.goal
    standing = jnp.where(state.active, NO_BAY, goal)
    free = free_bays(layout, jnp.concatenate([state.parked_cars.bay, standing]))
    size = state.physics.vehicle.size
    usable = bay_fits(config, layout, size, state.parked_cars.size).agents
    seen = config.observation.bays_in_view(state)
    if seen is not None:
        usable = seen if usable is None else seen & usable
    if usable is not None:
        free = free & usable
    before = state.tracked_bays
    if config.goals.slots_by_distance:  # empty: the nearest enters the first slot
        before = jnp.full_like(before, NO_BAY)
    tracked = nearest_bays(layout, state.motion.xy, free, before)
    lost = (goal != NO_BAY) & ~(tracked == goal[:, None]).any(axis=1) & state.active
    goal = jnp.where(lost, NO_BAY, goal)
    return dataclasses.replace(state, tracked_bays=tracked, goal=goal)


def nearest_bays(
    layout: Layout, xy: jax.Array, free: jax.Array, tracked_bays: jax.Array
) -> jax.Array:
    """Finds the free bays (bays,) or (num_agents, bays) nearest to agents at `xy`.

    Bays that are still among them keep their slots in `tracked_bays` (num_agents,
    num_tracked_bays). New bays take the slots that become empty, the nearest bay the
    first slot; a slot without a bay is `NO_BAY`.
    """
    num_agents, num_slots = tracked_bays.shape
    free = jnp.broadcast_to(free, (num_agents, layout.num_bays))
    bay, present = nearest(xy, layout.bay_pose[:, :2], free, num_slots)
    bay, present = bay[:, None, :], present[:, None, :]  # (agents, slots, ranks)
    same = (tracked_bays[:, :, None] == bay) & present
    empty = ~same.any(axis=2, keepdims=True)
    newcomer = present & ~same.any(axis=1, keepdims=True)
    # The k-th newcomer enters the k-th empty slot.
    turn = jnp.cumsum(empty, axis=1) == jnp.cumsum(newcomer, axis=2)
    here = same | (turn & empty & newcomer)
    return jnp.min(jnp.where(here, bay, NO_BAY), axis=2).astype(jnp.int32)


def tracks(config: EnvConfig, state: State) -> jax.Array:
    """(num_agents, num_agents) bool, [i, j] whether i tracks j, by measured poses."""
    found = config.observation.tracks_agents(state)
    count = state.goal.shape[0]
    return jnp.zeros((count, count), bool) if found is None else found


def find_contexts(
    before: State, chosen: jax.Array, tracked: jax.Array
) -> dict[str, jax.Array]:
    """Contexts (num_agents,) bool of each agent by name, see `CONTEXTS`.

    Agents that have finished are in no context and cause none; one that explored is in
    none. In `before` goals are not chosen yet, `chosen` (num_agents,) int32 are, and
    `tracked` are `tracks`.
    """
    goal, active = before.goal, before.active
    aim = before.layout.bay_pose[jnp.minimum(goal, before.layout.num_bays - 1), :2]
    distance = norm(before.motion.xy - aim[:, None])
    better = distance < jnp.diagonal(distance)[:, None]
    # The agent's own distance, computed twice, may round differently.
    own = jnp.eye(goal.shape[0], dtype=bool)
    better = better & ~own & active & active[:, None] & (goal != NO_BAY)[:, None]
    # Agents before one in the order have chosen already.
    number = jnp.arange(goal.shape[0])
    in_turn = jnp.where(number < number[:, None], chosen, goal)
    same = in_turn == goal[:, None]

    def some(condition: jax.Array) -> jax.Array:
        return (better & condition).any(axis=1)

    local_same, local_any = some(tracked & same), some(tracked)
    global_same, global_any = some(same), better.any(axis=1)
    return {
        "local_same": local_same,
        "local_any": local_any,
        "global_same": global_same,
        "global_any": global_any,
        "untracked_same": some(~tracked & same),
        "untracked_any": some(~tracked),
        "untracked_other": some(~tracked & ~same),
        "only_untracked_same": global_same & ~local_same,
        "only_untracked_any": global_any & ~local_any,
        "global_same_not_local_any": global_same & ~local_any,
    }

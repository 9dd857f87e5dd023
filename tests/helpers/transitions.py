"""A transition by hand, for what reads one."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import Layout
from carpark_mj.mdp import metrics
from carpark_mj.mdp.metrics.goals import CONTEXTS
from carpark_mj.mdp.rewards import term_names
from carpark_mj.types import (
    NO_BAY,
    EpisodeStats,
    Events,
    GoalEvents,
    Motion,
    ParkedCars,
    State,
    Transition,
)


def parked_cars(pose: Any = (), size: Any = 2.0, present: Any = True) -> ParkedCars:
    """Parked cars by hand, each in the bay of its own number."""
    pose = jnp.asarray(pose, jnp.float32).reshape(-1, 3)
    bay = jnp.arange(len(pose), dtype=jnp.int32)
    return ParkedCars(
        bay=jnp.where(jnp.asarray(present, bool), bay, NO_BAY),
        pose_w=pose,
        size=jnp.broadcast_to(jnp.asarray(size, jnp.float32), (len(pose), 2)),
    )


def no_events(count: int, **true: Any) -> Events:
    """Nothing happened to anybody, except what is given as flags (count,)."""
    flags = {f.name: jnp.zeros(count, bool) for f in dataclasses.fields(Events)}
    return Events(**(flags | {name: jnp.asarray(x, bool) for name, x in true.items()}))


def no_goal_events(count: int, **true: Any) -> GoalEvents:
    """The same of goals; contexts are given by their names among the others."""
    flags = {
        name: jnp.asarray(true.pop(name, jnp.zeros(count)), bool)
        for name in [f.name for f in dataclasses.fields(GoalEvents)] + [*CONTEXTS]
        if name != "contexts"
    }
    assert not true
    contexts: Any = {name: flags.pop(name) for name in CONTEXTS}
    return GoalEvents(contexts=contexts, **flags)


def no_terms(config: EnvConfig, layout: Layout) -> dict[str, jax.Array]:
    """A reward of nothing."""
    zero = jnp.zeros(config.num_agents)
    return dict.fromkeys(term_names(config, layout), zero)


def transition(
    config: EnvConfig,
    layout: Layout,
    before: Motion,
    after: Motion,
    stats: EpisodeStats | None = None,
    parked: ParkedCars | None = None,
    active: Any = True,
    tracked_bays: Any = None,
    **more: Any,
) -> Transition:
    """A step of cars (num_agents,), in which nothing happens but what is given.

    Args:
        config: says what is measured.
        layout: the lot.
        before: the agents at the start.
        after: at the end.
        stats: so far; those of new episodes if None.
        parked: parked cars, none if None.
        active: (num_agents,) bool.
        tracked_bays: (num_agents, num_tracked_bays) at the start.
        more: other attributes of the transition; the goal is bay 0 if not given.
    """
    count = before.pose_w.shape[0]
    assert count == config.num_agents
    goal = jnp.asarray(more.pop("goal", 0), jnp.int32)
    state = State(
        physics=None,  # type: ignore
        motion=before,
        layout=layout,
        goal=jnp.broadcast_to(goal, (count,)),
        tracked_bays=None if tracked_bays is None else jnp.array(tracked_bays),
        parked_cars=parked_cars() if parked is None else parked,
        ring_history=None,
        step=jnp.zeros(count, jnp.int32),
        active=jnp.broadcast_to(jnp.asarray(active, bool), (count,)),
        stats=metrics.init_stats(config, layout) if stats is None else stats,
        sensors=None,
        key=jax.random.key(0),
    )
    usual: dict[str, Any] = {
        "target_pose": layout.bay_pose[state.goal],
        "events": no_events(count),
        "goal_events": None,
        "wrong_way": None,
        "invalid_action": jnp.zeros(count, bool),
    }
    return Transition(
        before=state,
        after=state.replace(motion=after),
        goal=state.goal,
        **(usual | more),
    )

"""A transition by hand, for what reads one."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from helpers.states import state_of

from carpark_mj.mdp import metrics
from carpark_mj.mdp.metrics import CONTEXTS
from carpark_mj.mdp.rewards import term_weights
from carpark_mj.types import Events, GoalEvents, Transition

# What an agent can do with its goal, as fields of `GoalEvents`.
CHOICES = (
    "continue_explore",
    "stop_explore",
    "continue_goal",
    "change_goal",
    "stop_goal",
)


def no_events(count, **true):
    """Nothing happened to anybody, except what is given as flags (count,)."""
    nobody = jnp.asarray(np.zeros(count, bool))
    flags = {f.name: nobody for f in dataclasses.fields(Events)}
    return Events(**(flags | {name: jnp.asarray(x, bool) for name, x in true.items()}))


def no_goal_events(count, **true):
    """The same of goals; contexts are given by their names among the others."""
    names = {f.name for f in dataclasses.fields(GoalEvents)} - {"contexts"}
    unknown = set(true) - names - set(CONTEXTS)
    assert not unknown
    given = {name: jnp.asarray(flag, bool) for name, flag in true.items()}
    nobody = jnp.asarray(np.zeros(count, bool))
    return GoalEvents(
        contexts={name: given.get(name, nobody) for name in CONTEXTS},
        **{name: given.get(name, nobody) for name in names},
    )


def no_terms(config):
    """A reward of nothing."""
    zero = jnp.asarray(np.zeros(config.num_agents, np.float32))
    return dict.fromkeys(term_weights(config), zero)


def transition(config, layout, before, after, of_state=None, goal=0, **more):
    """A step of cars (num_agents,), in which nothing happens but what is given.

    `of_state` has attributes of the states, `more` of the transition; statistics are
    those of new episodes if not given.
    """
    count = before.yaw_rate.shape[0]
    assert count == config.num_agents
    state = state_of(layout, before, goal, stats=metrics.init_stats(config, layout))
    state = dataclasses.replace(state, **(of_state or {}))
    usual = {
        "target_pose": layout.bay_pose[state.goal],
        "events": no_events(count),
        "goal_events": None,
        "wrong_way": None,
        "invalid_action": jnp.asarray(np.zeros(count, bool)),
    }
    moved = dataclasses.replace(state, motion=after)
    return Transition(before=state, after=moved, **(usual | more))

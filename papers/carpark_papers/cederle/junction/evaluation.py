"""Whole episodes of a policy at a junction, for learners of any library.

The return ends with the first agent that is done, as in the study, for any end of
the training's episodes. The cars drive on until all are done, to count how many arrive.
"""

import dataclasses
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_papers.cederle.junction.config import JunctionConfig, Scenario
from carpark_papers.cederle.junction.env import JunctionEnv
from carpark_papers.cederle.junction.rules import State

Policy = Callable[[jax.Array], jax.Array]  # observations to actions, of all agents

RETURN_STEPS = 75  # the most that the return counts, the study's
MAX_STEPS = 150  # of an episode, so that cars that waited get through as well
NEVER = 2**31 - 1  # of `Outcomes.passed`


@struct.dataclass
class Outcomes:
    """Outcomes of episodes (episodes,)."""

    # undiscounted rewards of all agents together, to the study's end: the first
    # agent is done, or `RETURN_STEPS` are over
    returns: jax.Array
    length: jax.Array  # control steps to that end
    crashed: jax.Array  # an agent crashed, before that end or after it
    completed: jax.Array  # all agents arrived, before that end or after it
    # (episodes, cars) control steps after which the car was across the junction,
    # `NEVER` if it did not get there; cars in the scenario's order, whichever
    # agents have got the missions
    passed: jax.Array


@struct.dataclass
class Episode:
    """An episode under way."""

    state: State  # of the junction
    observation: jax.Array  # of all agents
    arrived: jax.Array  # (num_agents,) bool so far
    step: jax.Array  # () int32 control steps made
    outcomes: Outcomes  # so far, of this one episode


def evaluation_env(config: JunctionConfig, jitter: float) -> JunctionEnv:
    """The junction on which a policy trained with `config` is evaluated.

    The starts vary by `jitter` [m], so that episodes differ.
    """
    return JunctionEnv(
        dataclasses.replace(
            config, jitter=jitter, end="all", respawn=False, max_steps=MAX_STEPS
        )
    )


def begin(env: JunctionEnv, key: jax.Array) -> Episode:
    """Begins an episode in an environment of `evaluation_env`."""
    state, observation = env.reset(key)
    no, zero = jnp.zeros((), bool), jnp.zeros((), jnp.int32)
    passed = jnp.full(env.num_cars, NEVER)
    return Episode(
        state=state,
        observation=observation,
        arrived=jnp.zeros(env.num_agents, bool),
        step=zero,
        outcomes=Outcomes(jnp.zeros(()), zero, no, no, passed),
    )


def advance(env: JunctionEnv, episode: Episode, action: jax.Array) -> Episode:
    """Makes a control step with the actions of all agents, in `evaluation_env`."""
    before, out = episode.state, episode.outcomes
    counts = before.active.all() & (episode.step < RETURN_STEPS)
    state, timestep = env.step(before, action)
    # With joint rewards everybody has already got the sum.
    reward = timestep.reward
    earned = reward[0] if env.config.rewards.joint else reward.sum()
    arrived = episode.arrived | timestep.events.arrived
    crashed = out.crashed | timestep.events.crashed.any()
    # What crashed may still roll across.
    drives = before.present.at[: env.num_agents].set(state.active)
    across = drives & (state.along >= state.task.routes.curve[:, 1])
    if state.task.order is not None:
        across = jnp.zeros_like(across).at[state.task.order].set(across)
    step = episode.step + 1
    outcomes = Outcomes(
        returns=out.returns + jnp.where(counts, earned, 0.0),
        length=out.length + counts,
        crashed=crashed,
        # A car may reach its goal and hit another in one step.
        completed=arrived.all() & ~crashed,
        passed=jnp.minimum(out.passed, jnp.where(across, step, NEVER)),
    )
    return Episode(state, timestep.observation, arrived, step, outcomes)


def evaluate(env: JunctionEnv, policy: Policy, keys: jax.Array) -> Outcomes:
    """Drives one episode for each key (episodes,), side by side, as one program."""

    def whole(key: jax.Array) -> Outcomes:
        def step(episode: Episode, _: None) -> tuple[Episode, None]:
            return advance(env, episode, policy(episode.observation)), None

        begun = begin(env, key)
        return jax.lax.scan(step, begun, length=env.config.max_steps)[0].outcomes

    return jax.vmap(whole)(keys)


def car_names(traffic: Scenario) -> list[str]:
    """Names of cars in tables: the arms that agents come from, and `human`.

    Several from one arm are numbered.
    """
    names = [mission.route.start.split("-")[0] for mission in traffic.missions]
    names += ["human"] * len(traffic.human_cars)
    return [
        name if names.count(name) == 1 else f"{name}_{names[:k].count(name) + 1}"
        for k, name in enumerate(names)
    ]


def summarize(outcomes: Outcomes, traffic: Scenario) -> dict[str, float]:
    """Means over the episodes of an evaluation, as a row of `evaluations.csv`.

    `A_before_B`, for every pair of cars whose routes cross, is the share of episodes in
    which A crossed the junction and B crossed it later or not at all.
    """
    returns = np.asarray(outcomes.returns, float)
    passed = np.asarray(outcomes.passed)
    routes = [car.route for car in (*traffic.missions, *traffic.human_cars)]
    names = car_names(traffic)
    before = {
        f"{names[i]}_before_{names[j]}": float(np.mean(passed[:, i] < passed[:, j]))
        for i, j in itertools.permutations(range(len(names)), 2)
        if routes[i] != routes[j]
    }
    return {
        "episodes": len(returns),
        "return": float(returns.mean()),
        "return_std": float(returns.std()),
        "length": float(np.mean(outcomes.length)),
        "crashed": float(np.mean(np.asarray(outcomes.crashed, float))),
        "completed": float(np.mean(np.asarray(outcomes.completed, float))),
        "solved": int(returns.mean() >= traffic.solved),
        **before,
    }

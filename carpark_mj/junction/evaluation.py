"""Whole episodes of a policy at a junction, for learners of any library.

The study's return ends with the first agent that is done. To see whether everybody
gets through, the cars here drive on until all are done, and both are reported.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.junction.config import JunctionConfig
from carpark_mj.junction.env import JunctionEnv
from carpark_mj.junction.types import State

Policy = Callable[[jax.Array], jax.Array]  # observations to actions, of all agents

EXTRA_STEPS = 75  # after `JunctionConfig.max_steps`, for who waited


@struct.dataclass
class Outcomes:
    """What came of episodes (episodes,).

    Attributes:
        returns: undiscounted rewards of all agents together, to the study's end: that
            of `JunctionConfig.end`, at the latest `max_steps`.
        length: control steps to that end.
        crashed: an agent crashed, before that end or after it.
        completed: all agents arrived, before that end or after it.
    """

    returns: jax.Array
    length: jax.Array
    crashed: jax.Array
    completed: jax.Array


def evaluation_env(config: JunctionConfig, jitter: float) -> JunctionEnv:
    """The junction on which a policy trained with `config` is evaluated.

    Args:
        config: of the training.
        jitter: of the starts, so that episodes differ [m].

    Raises:
        ValueError: a jitter that would start a car off its lane.
    """
    return JunctionEnv(
        dataclasses.replace(
            config,
            jitter=jitter,
            end="all",
            restart=False,
            max_steps=config.max_steps + EXTRA_STEPS,
        )
    )


def evaluate(
    env: JunctionEnv, config: JunctionConfig, policy: Policy, keys: jax.Array
) -> Outcomes:
    """Drives one episode for each key, side by side.

    Args:
        env: of `evaluation_env`.
        config: of the training; when its episodes end, the return does.
        policy: actions of all agents from their observations.
        keys: (episodes,).
    """

    def episode(key: jax.Array) -> Outcomes:
        state, observation = env.reset(key)
        nothing = jnp.zeros((), bool)
        begun = Outcomes(jnp.zeros(()), jnp.zeros((), jnp.int32), nothing, nothing)
        arrived = jnp.zeros(env.num_agents, bool)

        def step(
            carry: tuple[State, jax.Array, jax.Array, Outcomes], number: jax.Array
        ) -> tuple[tuple[State, jax.Array, jax.Array, Outcomes], None]:
            state, observation, arrived, out = carry
            counts = state.active.any() & (number < config.max_steps)
            if config.end == "any":
                counts = counts & state.active.all()
            state, timestep = env.step(state, policy(observation))
            reward = timestep.reward
            # With joint rewards everybody has already got the sum.
            earned = reward[0] if config.rewards.joint else reward.sum()
            arrived = arrived | timestep.events.arrived
            out = Outcomes(
                returns=out.returns + jnp.where(counts, earned, 0.0),
                length=out.length + counts,
                crashed=out.crashed | timestep.events.crashed.any(),
                completed=arrived.all(),
            )
            return (state, timestep.observation, arrived, out), None

        carry = (state, observation, arrived, begun)
        steps = jnp.arange(env.config.max_steps)
        (*_, out), _ = jax.lax.scan(step, carry, steps)
        # A car may reach its goal and another one in the same step.
        return dataclasses.replace(out, completed=out.completed & ~out.crashed)

    return jax.vmap(episode)(keys)


def summarize(outcomes: Outcomes, solved: float) -> dict[str, float]:
    """Means over episodes, as a row of `evaluations.csv`.

    Args:
        outcomes: of one evaluation.
        solved: mean return from which the scenario counts as solved.
    """
    returns = np.asarray(outcomes.returns, float)
    return {
        "episodes": len(returns),
        "return": float(returns.mean()),
        "return_std": float(returns.std()),
        "length": float(np.mean(outcomes.length)),
        "crashed": float(np.mean(outcomes.crashed)),
        "completed": float(np.mean(outcomes.completed)),
        "solved": int(returns.mean() >= solved),
    }

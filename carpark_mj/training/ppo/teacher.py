"""A policy whose actions a training imitates at the states that its own agents reach.

As in DAgger (Ross et al. 2011) the learner drives, so that it learns what to do where
it gets to itself; as in kickstarting (Schmitt et al. 2018) the imitation is a term of
the loss that ends, while the reward is learned from all along. The teacher may observe
what the learner does not.
"""

import dataclasses
from typing import Any

import jax

from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import observe
from carpark_mj.policy.loading import load_policy
from carpark_mj.training.ppo.collect import Teacher
from carpark_mj.training.ppo.config import PPOConfig


def make_teacher(config: PPOConfig) -> Teacher | None:
    """The teacher of a training; None without one.

    Raises:
        CheckpointError: it has no checkpoint.
        ValueError: it does not drive such cars, remembers, needs routes that lots lack,
            or actions have indices.
    """
    name = config.curriculum.teacher
    if not name:
        return None
    if action_spec(config.env).choices:
        raise ValueError(
            f"curriculum.teacher {name} needs actions of numbers alone, not of choices"
        )
    seen = load_policy(name).env.observation
    env = dataclasses.replace(config.env, observation=seen)
    if seen.init_memory(env) is not None:
        raise ValueError(
            f"curriculum.teacher {name} remembers, which only agents do that observe "
            "as it does"
        )
    if env.follows_routes and not config.env.follows_routes:
        raise ValueError(
            f"curriculum.teacher {name} observes routes, which lots have if they are "
            "observed or rewarded: env.reward.route must be True, not False"
        )
    policy = load_policy(name, env=env).policy

    def advise(lots: Any) -> jax.Array:
        seen = jax.vmap(lambda state: observe(env, state))(lots)
        action, _ = policy(seen.reshape(-1, seen.shape[-1]), jax.random.key(0))
        return action

    return advise

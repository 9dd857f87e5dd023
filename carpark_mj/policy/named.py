"""Untrained policies by name: baselines, planners and those of other packages."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from carpark_mj.env import ParkingEnv
from carpark_mj.extensions import Registry
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.acting import AnyPolicy
from carpark_mj.policy.networks import Policy

# Functions that make the policy for an environment, or raise `ValueError`.
POLICIES: Registry[Callable[[ParkingEnv], AnyPolicy]] = Registry(
    "policy", "carpark_mj.planning.policy"
)


def zero_policy(action: ActionSpec) -> Policy:
    """Takes the middle of every range; a standing car stays where it is."""

    def policy(observation: jax.Array, key: jax.Array):
        del key
        shape = (*observation.shape[:-1], action.size)
        return jnp.broadcast_to(action.middle, shape), {}

    return policy


def random_policy(action: ActionSpec) -> Policy:
    """Draws every number and every index of an action uniformly."""

    def policy(observation: jax.Array, key: jax.Array):
        lead, keys = observation.shape[:-1], (key, key)
        if action.choices:
            keys = jax.random.split(key)
        shape = (*lead, action.continuous)
        numbers = jax.random.uniform(keys[0], shape, minval=-1.0, maxval=1.0)
        counts = jnp.array(action.choices, jnp.int32)
        indices = jax.random.randint(keys[1], (*lead, len(counts)), 0, counts)
        parts = [part.astype(action.dtype) for part in (numbers, indices)]
        return jnp.concatenate(parts, axis=-1), {}

    return policy


POLICIES.register("zero", lambda env: zero_policy(env.action_spec))
POLICIES.register("random", lambda env: random_policy(env.action_spec))

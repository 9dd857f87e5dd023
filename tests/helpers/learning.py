"""Rollouts and states by hand, for the tests of updates."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.flatten_util import ravel_pytree

from carpark_mj.policy.networks import init_normalizer
from carpark_mj.training.ppo.collect import Rollout
from carpark_mj.training.ppo.learn import network_params


def rollout(shape: tuple[int, int], size: int = 3, **given: Any) -> Rollout:
    """Steps (time, agents) in which nothing happens but what is given."""
    zero = jnp.zeros(shape)
    usual = dict.fromkeys(("log_prob", "reward", "terminated", "truncated"), zero)
    usual |= {"observation": jnp.zeros((*shape, size))}
    usual |= {"raw_action": jnp.zeros((*shape, 2))}
    usual |= {"final_observation": jnp.zeros((shape[1], size))}
    return Rollout(**(usual | given))


def begun(networks: Any, inputs: Any, key: Any, update: int = 0, **given: Any) -> Any:
    """What `learn` reads of a state, with Adam's; networks are drawn by a key."""
    keys = jax.random.split(key)
    params = network_params(
        networks.policy_network.init(keys[0]), networks.value_network.init(keys[1])
    )
    usual = {
        "update": jnp.int32(update),
        "seconds": jnp.float32(0.0),
        "normalizer": init_normalizer(inputs),
        "policy": params.policy,
        "value": params.value,
        "optimizer": optax.scale_by_adam().init(ravel_pytree(params)[0]),
    }
    return SimpleNamespace(**(usual | given))


def assert_close(found: Any, expected: Any, **tolerance: Any) -> None:
    """Asserts that two trees have the same numbers, leaf by leaf."""
    for a, b in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(a, b, **tolerance)

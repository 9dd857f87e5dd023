"""Policies with random weights, to be exported as ONNX models."""

import functools
from pathlib import Path

import jax
import numpy as np

from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields, observation_size
from carpark_mj.policy.loading import LoadedPolicy
from carpark_mj.policy.networks import (
    NetworkConfig,
    init_normalizer,
    make_finish,
    make_networks,
    make_policy,
    network_inputs,
    update_normalizer,
)


@functools.cache
def untrained(env, encoder="set", seed=1, **choices):
    """A policy with random weights, whose statistics are those of random numbers."""
    config = NetworkConfig((16,), (16,), encoder, **choices)
    fields = make_fields(env)
    networks = make_networks(config, fields, action_spec(env))
    inputs = network_inputs(config, fields)

    @jax.jit
    def draw(key):
        keys = jax.random.split(key)
        seen = 0.3 + 0.5 * jax.random.normal(keys[0], (100, observation_size(env)))
        normalizer = update_normalizer(inputs, init_normalizer(inputs), seen)
        return normalizer, networks.policy_network.init(keys[1])

    finish = make_finish(config, fields, action_spec(env))
    policy = make_policy(networks, *draw(jax.random.key(seed)), True, finish)
    return LoadedPolicy(env, policy, 0, Path("none"), config)


def observations(env, count=10_000):
    """Independent numbers (count, size) in the ranges of the fields, near 0.3."""
    fields, random = make_fields(env), np.random.default_rng(1)
    low, high = (
        np.concatenate([np.full(field.size, getattr(field, end)) for field in fields])
        for end in ("low", "high")
    )
    size = (count, len(low))
    if all(field.is_whole for field in fields):
        return random.integers(low, high + 1, size).astype(np.float32)
    middle = np.clip(0.3, low, high)
    low, high = np.maximum(low, middle - 1.5), np.minimum(high, middle + 1.5)
    return random.uniform(low, high, size).astype(np.float32)

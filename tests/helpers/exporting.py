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
    make_networks,
    make_policy,
    network_inputs,
    update_normalizer,
)
from carpark_mj.policy.onnx_export import random_observations


@functools.cache
def untrained(env, encoder="set", seed=1):
    """A policy with random weights, whose statistics are those of random numbers."""
    config = NetworkConfig((16,), (16,), encoder)
    fields = make_fields(env)
    networks = make_networks(config, fields, action_spec(env))
    inputs = network_inputs(config, fields)

    @jax.jit
    def draw(key):
        keys = jax.random.split(key)
        seen = 0.3 + 0.5 * jax.random.normal(keys[0], (100, observation_size(env)))
        normalizer = update_normalizer(inputs, init_normalizer(inputs), seen)
        return normalizer, networks.policy_network.init(keys[1])

    policy = make_policy(networks, *draw(jax.random.key(seed)), deterministic=True)
    return LoadedPolicy(env, policy, 0, Path("none"))


def observations(env, count=10_000):
    typical = np.random.default_rng(0).normal(0.3, 0.5, (count, observation_size(env)))
    return random_observations(env, typical, seed=1)

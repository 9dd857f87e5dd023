"""Recording in compiled stretches, with the policy as an argument of the program."""

import dataclasses

import jax
import numpy as np
import pytest
from helpers.sliding import SlidePhysics
from jax.experimental.compilation_cache import compilation_cache

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.rollout import evaluate
from carpark_mj.observations import make_fields
from carpark_mj.policy.baselines import random_policy
from carpark_mj.policy.networks import (
    NetworkConfig,
    make_networks,
    make_policy,
    network_inputs,
)
from carpark_mj.policy.normalizer import init_normalizer
from carpark_mj.rendering import rollout
from carpark_mj.rendering.rollout import record


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(EnvConfig(num_agents=2, num_parked_cars=4), SlidePhysics())


@pytest.mark.parametrize("steps", [1, 4, 5])
def test_the_length_of_the_stretches_makes_no_difference(env, steps, monkeypatch):
    policy = random_policy(env.action_spec)
    once = record(env, policy, steps, seed=1)
    monkeypatch.setattr(rollout, "CHUNK", 2)
    again = record(env, policy, steps, seed=1)
    assert once.pose_w.shape[0] == steps
    for field in dataclasses.fields(once):
        if field.name != "layout":
            np.testing.assert_array_equal(
                getattr(again, field.name), getattr(once, field.name), field.name
            )


@pytest.fixture
def programs(tmp_path):
    """Lists the programs compiled so far."""
    settings = {
        "jax_compilation_cache_dir": str(tmp_path),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
    yield lambda: {path.name for path in tmp_path.glob("*-cache")}
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


@pytest.mark.parametrize(
    "drive",
    [lambda *args: record(*args, 2, 0), lambda *args: evaluate(*args, 2, 0)],
    ids=["record", "evaluate"],
)
def test_another_checkpoint_needs_no_other_program(env, drive, programs):
    config, fields = NetworkConfig((8,), (8,)), make_fields(env.config)
    networks = make_networks(config, fields, env.action_spec)
    normalizer = init_normalizer(network_inputs(config, fields))
    init = jax.jit(networks.policy_network.init)
    weights = [init(jax.random.key(seed)) for seed in (0, 1)]
    drive(env, make_policy(networks, normalizer, weights[0], True))
    compiled = programs()
    assert compiled
    drive(env, make_policy(networks, normalizer, weights[1], True))
    assert programs() == compiled

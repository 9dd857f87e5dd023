"""Updates from pictures, and policies that learn to see."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
from helpers.learning import begun, rollout

from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.config import EnvConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import (
    NetworkConfig,
    init_normalizer,
    make_networks,
    network_inputs,
)
from carpark_mj.training.ppo import variants
from carpark_mj.training.ppo.collect import AXIS
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learn import learn
from carpark_mj.training.ppo.variants import ppo_loss
from carpark_mj.training.ppo.warm_start import new_fields, widen

LENGTH, AGENTS = 3, 4
FIELDS = (
    Field("speed", 2, -1.0, 1.0, ""),
    Field("depth", 16, 0.0, 1.0, "", shape=(1, 4, 4)),
)
CONFIG = PPOConfig(
    num_lots=AGENTS,
    unroll_length=LENGTH,
    num_minibatches=1,
    num_epochs=1,
    networks=NetworkConfig((4,), (4,), own_size=4, picture_size=4),
    env=EnvConfig(num_agents=1),
)


def test_an_update_values_all_steps_and_teaches_the_eye(monkeypatch):
    """Every step ends an episode, so that a critic's value is reward less advantage."""
    networks = make_networks(CONFIG.networks, FIELDS, ActionSpec(2))
    inputs, optimizer = network_inputs(CONFIG.networks, FIELDS), optax.scale_by_adam()

    def loss(params, networks, normalizer, batch, weights, key):
        total, told = ppo_loss(params, networks, normalizer, batch, weights, key)
        apply = networks.value_network.apply
        expected = apply(normalizer, params.value, batch.observation)
        error = jnp.abs(batch.target - batch.advantage - expected).max()
        return total, told | {"error": error, "spread": jnp.std(expected)}

    monkeypatch.setattr(variants, "ppo_loss", loss)

    def update(key):
        keys = jax.random.split(key, 5)
        shape, one = (LENGTH, AGENTS), jnp.ones((LENGTH, AGENTS))
        steps = rollout(
            shape,
            inputs.size,
            observation=jax.random.uniform(keys[0], (*shape, inputs.size)),
            raw_action=jax.random.normal(keys[1], (*shape, 2)),
            log_prob=-one,
            reward=jax.random.normal(keys[2], shape),
            terminated=one,
        )
        state = begun(networks, inputs, keys[3])
        learned = learn(CONFIG, networks, inputs, optimizer, state, steps, keys[4])
        return learned, state.policy, state.value

    key = jax.random.split(jax.random.key(0), 1)
    (learned, told), *before = jax.jit(jax.vmap(update, axis_name=AXIS))(key)
    assert float(told["error"][0]) < 1e-5 < float(told["spread"][0])
    for old, new in zip(before, learned[1:3], strict=True):
        moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), old, new)
        layers = moved["params"]["SetEncoder_0"]["pictures_1x4x4"]
        assert min(jax.tree.leaves(layers)) > 0.0
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(new))


def test_a_critic_that_learns_to_see_judges_as_before():
    blind, sees = (
        dataclasses.replace(CONFIG.env, observation=observation)
        for observation in (
            ContinuousObservation(),
            CameraObservation(width=4, height=3),
        )
    )
    config = dataclasses.replace(CONFIG, env=sees)
    assert new_fields(config, blind) == ["camera_depth", "camera_seen"]

    def begin(env, key):
        fields = make_fields(env)
        critic = make_networks(config.networks, fields, ActionSpec(2)).value_network
        inputs = network_inputs(config.networks, fields)
        value = jax.jit(critic.init)(key)
        weights = {"normalizer": init_normalizer(inputs), "value": value}
        return jax.jit(critic.apply), weights, inputs.size

    before, theirs, fewer = begin(blind, jax.random.key(0))
    after, new, size = begin(sees, jax.random.key(1))
    ours = widen(config, blind, theirs, new)
    assert jax.tree.map(jnp.shape, ours) == jax.tree.map(jnp.shape, new)
    rng = np.random.default_rng(2)
    seen = rng.uniform(size=(5, size)).astype(np.float32)  # pictures come last
    np.testing.assert_allclose(
        after(ours["normalizer"], ours["value"], seen),
        before(theirs["normalizer"], theirs["value"], seen[:, :fewer]),
        rtol=1e-5,
    )

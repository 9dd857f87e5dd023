"""The details of ML-Agents' PPO: its loss by a plain loop, its steps and weights."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from helpers import learning, splitting

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, init_normalizer, make_networks
from carpark_mj.training.ppo.collect import AXIS, compute_advantages
from carpark_mj.training.ppo.config import CurriculumConfig
from carpark_mj.training.ppo.learn import learn, network_params
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.variants import Minibatch, Weights
from carpark_papers.tanner import ml_agents
from carpark_papers.tanner.ml_agents import (
    Steps,
    initial_weights,
    ml_agents_loss,
    prepare_steps,
)

SIZE, CHOICES, COUNT = 4, (3, 2), 40
NETWORKS = make_networks(
    NetworkConfig((300, 200), (100,), encoder="flat"),
    [Field("x", SIZE, -1.0, 1.0, "")],
    ActionSpec(0, CHOICES),
)
NORMALIZER = init_normalizer(ObservationSets(SIZE))
CLIP, ENTROPY = 0.2, 0.01


def fresh(seed):
    """Actor and critic with weights as ML-Agents starts them."""
    drawn = network_params(
        NETWORKS.policy_network.init(jax.random.key(8)),
        NETWORKS.value_network.init(jax.random.key(9)),
    )
    return initial_weights(drawn, jax.random.key(seed))


def steps(rng, params):
    """Made-up steps (COUNT, ...) of choices that the actor could have made."""
    normal = rng.normal(size=(COUNT, SIZE + 2)).astype(np.float32)
    index = np.stack([rng.integers(0, n, COUNT) for n in CHOICES], axis=-1)
    batch = Minibatch(
        observation=jnp.asarray(normal[:, :SIZE]),
        raw_action=jnp.asarray(index, jnp.int32),
        log_prob=jnp.zeros(COUNT),
        advantage=jnp.asarray(3.0 + 2.0 * normal[:, SIZE]),
        target=jnp.asarray(normal[:, SIZE + 1]),
        weight=jnp.asarray(rng.random(COUNT) < 0.8, jnp.float32),
    )
    prepare = jax.vmap(
        lambda part: prepare_steps(params, NETWORKS, NORMALIZER, part), axis_name=AXIS
    )
    halves = jax.tree.map(lambda x: x.reshape(2, COUNT // 2, *x.shape[1:]), batch)
    prepared = prepare(halves)
    return jax.tree.map(lambda x: x.reshape(COUNT, *x.shape[2:]), prepared)


def test_advantages_are_normalised_over_the_steps_of_all_devices():
    found = steps(np.random.default_rng(0), fresh(0))
    counted = found.advantage[found.weight > 0]
    assert counted.mean() == pytest.approx(0.0, abs=1e-5)
    assert counted.std() == pytest.approx(1.0, abs=1e-5)
    # Neither those of one device alone are, nor all with the truncated ones.
    first, every = found.advantage[: COUNT // 2], found.advantage
    assert abs(first[found.weight[: COUNT // 2] > 0].mean()) > 1e-3
    assert abs(every.mean()) > 1e-3
    assert found.log_prob.shape == (COUNT, len(CHOICES))


def test_advantages_are_those_of_schulman_2016():
    """By his equation 16, backwards, and not Brax's."""
    rng, params, discount, lam = np.random.default_rng(4), fresh(0), 0.9, 0.6
    length, agents = 10, 4
    observation = jnp.asarray(rng.normal(size=(length, agents, SIZE)), jnp.float32)
    reward = rng.normal(size=(length, agents))
    terminated = (rng.random((length, agents)) < 0.2).astype(float)
    values = NETWORKS.value_network.apply(NORMALIZER, params.value, observation)
    final = jnp.asarray(rng.normal(size=agents), jnp.float32)
    rollout = learning.rollout(
        (length, agents),
        observation=observation,
        raw_action=jnp.zeros((length, agents, 2), jnp.int32),
        reward=jnp.asarray(reward, jnp.float32),
        terminated=jnp.asarray(terminated, jnp.float32),
        final_observation=observation[-1],
    )
    zero = rollout.log_prob
    brax, target = compute_advantages(rollout, values, final, discount, lam)
    batch = Minibatch(
        observation, rollout.raw_action, zero, brax, target, jnp.ones((length, agents))
    )
    prepare = jax.vmap(
        lambda part: prepare_steps(params, NETWORKS, NORMALIZER, part), axis_name=AXIS
    )
    found = prepare(jax.tree.map(lambda x: x[None], batch)).advantage[0]

    expected, later = np.zeros((length, agents)), np.zeros(agents)
    next_value = np.asarray(final)
    for k in reversed(range(length)):
        goes_on = discount * (1 - terminated[k])
        error = reward[k] + goes_on * next_value - np.asarray(values[k])
        expected[k] = later = error + goes_on * lam * later
        next_value = np.asarray(values[k])
    expected = (expected - expected.mean()) / expected.std()
    np.testing.assert_allclose(found, expected, atol=1e-5)
    brax = (brax - brax.mean()) / brax.std()
    assert np.abs(brax - expected).max() > 0.1


def plain_loss(logits, value, batch: Steps):
    """The loss one step and one branch after the other."""
    policy = error = entropy = 0.0
    counted = np.flatnonzero(batch.weight)
    for k in counted:
        first = 0
        for branch, n in enumerate(CHOICES):
            part = np.exp(logits[k, first : first + n])
            p, first = part / part.sum(), first + n
            chosen = int(batch.raw_action[k, branch])
            ratio = p[chosen] / math.exp(float(batch.log_prob[k, branch]))
            bounded = min(max(ratio, 1 - CLIP), 1 + CLIP)
            gain = float(batch.advantage[k])
            policy -= min(ratio * gain, bounded * gain) / len(CHOICES)
            entropy -= (p * np.log(p)).sum()
        old, target = float(batch.value[k]), float(batch.target[k])
        near = old + min(max(value[k] - old, -CLIP), CLIP)
        error += max((target - value[k]) ** 2, (target - near) ** 2)
    count = len(counted)
    return policy / count, 0.5 * error / count, -ENTROPY * entropy / count


def loss_of(params, batch, entropy_cost):
    """The loss of a minibatch that one device holds."""

    def loss(batch):
        weights = Weights(jnp.float32(entropy_cost), jnp.float32(CLIP))
        key = jax.random.key(0)
        return ml_agents_loss(params, NETWORKS, NORMALIZER, batch, weights, key)

    one = jax.tree.map(lambda x: x[None], batch)
    found = jax.vmap(loss, axis_name=AXIS)(one)
    return jax.tree.map(lambda x: x[0], found)


def test_the_loss_is_that_of_a_plain_loop():
    old, new = fresh(0), fresh(1)
    # Larger weights, so that many ratios are clipped.
    new = jax.tree.map(lambda x: 3.0 * x, new)
    batch = steps(np.random.default_rng(1), old)
    total, parts = loss_of(new, batch, ENTROPY)
    logits = NETWORKS.policy_network.apply(NORMALIZER, new.policy, batch.observation)
    value = NETWORKS.value_network.apply(NORMALIZER, new.value, batch.observation)
    logits, value = np.asarray(logits, float), np.asarray(value, float)
    expected = plain_loss(logits, value, batch)
    names = ("policy_loss", "v_loss", "entropy_loss")
    found = [float(parts[name]) for name in names]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    assert float(total) == pytest.approx(sum(expected), rel=1e-4)
    # Both clips matter here.
    log_prob = np.log(np.exp(logits[:, :3]) / np.exp(logits[:, :3]).sum(1)[:, None])
    chosen = np.take_along_axis(log_prob, np.asarray(batch.raw_action[:, :1]), axis=1)
    ratio = np.exp(chosen[:, 0] - np.asarray(batch.log_prob[:, 0]))
    assert (np.abs(ratio - 1.0) > CLIP).any()
    assert (np.abs(value - np.asarray(batch.value)) > CLIP).any()


def test_before_the_update_ratios_are_one():
    params = fresh(0)
    batch = steps(np.random.default_rng(2), params)
    _, parts = loss_of(params, batch, 0.0)
    assert float(parts["kl_mean"]) == pytest.approx(0.0, abs=1e-6)
    assert float(parts["policy_loss"]) == pytest.approx(0.0, abs=1e-5)


def test_initial_weights_have_the_spread_of_their_layers():
    params = fresh(3)
    actor, critic = params.policy["params"], params.value["params"]
    for layers, name, spread in (
        (actor, "hidden_0", 1 / math.sqrt(SIZE)),
        (actor, "hidden_1", 1 / math.sqrt(300)),
        (actor, "hidden_2", 0.1 / math.sqrt(200)),
        (critic, "hidden_0", 1 / math.sqrt(SIZE)),
        (critic, "hidden_1", math.sqrt(2 / (100 + 1))),
    ):
        kernel = np.asarray(layers[name]["kernel"])
        # Five standard deviations of a sample's spread.
        assert kernel.std() == pytest.approx(spread, rel=5 / math.sqrt(2 * kernel.size))
        np.testing.assert_array_equal(layers[name]["bias"], 0.0)
    edge = math.sqrt(6 / (100 + 1))
    assert np.abs(critic["hidden_1"]["kernel"]).max() <= edge  # uniform


def test_an_epoch_learns_once_from_every_step(monkeypatch):
    length, agents, parts = 12, 6, 6
    config = dataclasses.replace(
        PRESETS["tanner-fixed-original"], num_epochs=3, num_minibatches=parts
    )
    number = jnp.arange(length * agents, dtype=jnp.float32).reshape(length, agents)
    rollout = learning.rollout(
        (length, agents),
        SIZE,
        observation=jnp.broadcast_to(number[..., None], (length, agents, SIZE)),
        raw_action=jnp.zeros((length, agents, 2), jnp.int32),
    )
    inputs, optimizer = ObservationSets(SIZE), optax.scale_by_adam()
    state = learning.begun(NETWORKS, inputs, jax.random.key(0))

    def watch(params, networks, normalizer, batch, weights, key):
        step = batch.observation[:, 0]
        assert step.shape == (length * agents // parts,)
        seen = {"mean": step.mean(), "square": jnp.square(step).mean()}
        same_agent = (step[1:] % agents == step[:-1] % agents).mean()
        loss = sum(jnp.sum(x) for x in jax.tree.leaves(params))
        return loss, seen | {"same_agent": same_agent}

    monkeypatch.setattr(ml_agents, "ml_agents_loss", watch)

    def update(key):
        found = learn(config, NETWORKS, inputs, optimizer, state, rollout, key)
        return found[0][0], found[1]

    keys = jax.random.split(jax.random.key(0), 1)
    normalizer, seen = jax.vmap(update, axis_name=AXIS)(keys)
    np.testing.assert_allclose(seen["mean"], number.mean(), rtol=1e-5)
    np.testing.assert_allclose(seen["square"], np.square(number).mean(), rtol=1e-5)
    # By chance every sixth; all of them if a minibatch were an agent's steps.
    assert seen["same_agent"][0] < 0.4
    for old, new in zip(*map(jax.tree.leaves, (NORMALIZER, normalizer)), strict=True):
        np.testing.assert_array_equal(new[0], old)  # nothing is normalised


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"variant": "keras"}, "unknown variant 'keras'; choose from"),
        (
            {"variant": "ml-agents", "env": PRESETS["square"].env},
            "'ml-agents' needs env.physics 'grid'",
        ),
        (
            {"variant": "ml-agents", "networks": NetworkConfig()},
            "'ml-agents' needs networks.encoder 'flat'",
        ),
        (
            {"curriculum": CurriculumConfig(neighbour_share=0.5)},
            "'ml-agents' needs curriculum.neighbour_share 0",
        ),
    ],
)
def test_what_the_details_do_not_fit_is_refused_in_a_sentence(change, message):
    with pytest.raises(ValueError, match=message) as caught:
        dataclasses.replace(PRESETS["tanner-fixed-original"], **change)
    assert "\n" not in str(caught.value)


def test_devices_learn_together_what_one_learns():
    splitting.assert_alike("ml-agents")

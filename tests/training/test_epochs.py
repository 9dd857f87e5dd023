"""What updates learn with: schedules, advantages, which steps, and pictures."""

import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from brax.training.agents.ppo.losses import compute_gae
from helpers.learning import SMALL, acted, begun, rollout, sliding_learner, unrolled
from helpers.sliding import POSES
from helpers.trees import assert_close

from carpark_mj.config import EnvConfig, insert
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN, ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import (
    NetworkConfig,
    init_normalizer,
    make_networks,
    network_inputs,
)
from carpark_mj.training.ppo import variants
from carpark_mj.training.ppo.collect import (
    AXIS,
    compute_advantages,
    count_steps,
    drop_absent,
)
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import learn, network_params, num_learned, schedule
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.variants import Minibatch, Weights, ppo_loss

LENGTH, AGENTS, SIZE, PARTS = 6, 12, 3, 4
CONFIG = PPOConfig(
    num_steps=100 * LENGTH * AGENTS,  # 100 updates
    num_lots=AGENTS,
    unroll_length=LENGTH,
    num_minibatches=PARTS,
    num_epochs=3,
    entropy_cost=0.4,
    entropy_cost_end=0.1,
    clip=0.3,
    clip_end=0.1,
    discount=0.9,
    gae_lambda=1.0,
    curriculum=CurriculumConfig(discount_end=0.99),
    networks=NetworkConfig((4,), (4,), encoder="flat"),
    env=EnvConfig(num_agents=1),
)
NETWORKS = make_networks(
    CONFIG.networks, [Field("x", SIZE, -1.0, 1.0, "")], ActionSpec(2)
)


def test_schedules_are_linear_and_stay_at_their_ends():
    progress = jnp.array([-1.0, 0.0, 0.25, 1.0, 3.0])
    np.testing.assert_allclose(
        schedule(1e-3, 2e-4, progress), [1e-3, 1e-3, 8e-4, 2e-4, 2e-4], rtol=1e-6
    )


def steps():
    """Agents that observe their own number; the last step alone pays."""
    number = jnp.arange(AGENTS, dtype=jnp.float32)[:, None]
    return rollout(
        (LENGTH, AGENTS),
        observation=jnp.broadcast_to(number, (LENGTH, AGENTS, SIZE)),
        reward=jnp.zeros((LENGTH, AGENTS)).at[-1].set(1.0),
        final_observation=jnp.broadcast_to(number, (AGENTS, SIZE)),
    )


def watched(monkeypatch, watch, update=0):
    """The mean of what `watch(batch, weights)` reports of the minibatches of an update.

    The critic says 0 of everything, and learns nothing.
    """

    def loss(params, networks, normalizer, batch, weights, key):
        total = sum(jnp.sum(x) for x in jax.tree.leaves(params))
        return 0.0 * total, watch(batch, weights)

    monkeypatch.setattr(variants, "ppo_loss", loss)
    optimizer, inputs = optax.scale_by_adam(), ObservationSets(SIZE)
    state = begun(NETWORKS, inputs, jax.random.key(0), update)
    state.value = jax.tree.map(jnp.zeros_like, state.value)

    def learned(key):
        return learn(CONFIG, NETWORKS, inputs, optimizer, state, steps(), key)[1]

    keys = jax.random.split(jax.random.key(2), 1)
    found = jax.jit(jax.vmap(learned, axis_name=AXIS))(keys)
    jax.effects_barrier()
    return {name: float(x[0]) for name, x in found.items()}


@pytest.mark.parametrize(
    ("update", "entropy_cost", "clip", "horizon"),
    [(0, 0.4, 0.3, 10.0), (55, 0.235, 0.19, 55.0), (100, 0.1, 0.1, 100.0)],
)
def test_an_update_learns_with_the_settings_of_its_progress(
    monkeypatch, update, entropy_cost, clip, horizon
):
    def watch(batch, weights):
        first = batch.target.reshape(LENGTH, -1)[0]
        return {"cost": weights.entropy_cost, "clip": weights.clip, "x": first.mean()}

    found = watched(monkeypatch, watch, update)
    assert found["cost"] == pytest.approx(entropy_cost, rel=1e-5)
    assert found["clip"] == pytest.approx(clip, rel=1e-5)
    # Paid after five more steps, each of which discounts it.
    discount = 1.0 - 1.0 / horizon
    assert found["x"] == pytest.approx(discount ** (LENGTH - 1), rel=1e-5)


def test_every_epoch_learns_from_all_agents_in_other_minibatches(monkeypatch):
    seen = []

    def note(numbers):
        seen.append(tuple(np.unique(numbers).astype(int).tolist()))

    def watch(batch, weights):
        jax.debug.callback(note, batch.observation[:, 0])
        return {}

    watched(monkeypatch, watch)
    assert len(seen) == CONFIG.num_epochs * PARTS
    assert {len(agents) for agents in seen} == {AGENTS // PARTS}
    times = collections.Counter(agent for agents in seen for agent in agents)
    assert times == dict.fromkeys(range(AGENTS), CONFIG.num_epochs)
    # In any fixed order the same four would come in every epoch.
    assert len(set(seen)) > 2 * PARTS


@pytest.mark.parametrize("gae_lambda", [0.0, 0.92, 1.0])
def test_advantages_are_brax_s(gae_lambda):
    rng = np.random.default_rng(0)
    reward, values = jnp.asarray(rng.normal(size=(2, 20, 30)), jnp.float32)
    final = jnp.asarray(rng.normal(size=30), jnp.float32)
    ends = jnp.asarray(rng.random((20, 30)) < 0.2, jnp.float32)
    cut = ends * (rng.random((20, 30)) < 0.5)
    given = {"reward": reward, "terminated": ends - cut, "truncated": cut}
    steps = rollout((20, 30), **given)
    ours = compute_advantages(steps, values, final, 0.99, gae_lambda)
    targets, advantages = compute_gae(
        cut, ends - cut, reward, values, final, gae_lambda, 0.99
    )
    np.testing.assert_array_equal(ours[0], advantages)
    np.testing.assert_array_equal(ours[1], targets)


STEPS, CARS = 3, 4
FIELDS = (
    Field("speed", 2, -1.0, 1.0, ""),
    Field("depth", 16, 0.0, 1.0, "", shape=(1, 4, 4)),
)
SIGHT = NetworkConfig((4,), (4,), own_size=4, picture_size=4)
SIZES = {"num_lots": CARS, "unroll_length": STEPS, "env": EnvConfig(num_agents=1)}
SEEING = insert(SMALL, SIZES | {"networks": SIGHT})


def test_an_update_values_all_steps_and_teaches_the_eye(monkeypatch):
    """Every step ends an episode, so that a critic's value is reward less advantage."""
    networks = make_networks(SEEING.networks, FIELDS, ActionSpec(2))
    inputs, optimizer = network_inputs(SEEING.networks, FIELDS), optax.scale_by_adam()

    def loss(params, networks, normalizer, batch, weights, key):
        total, told = ppo_loss(params, networks, normalizer, batch, weights, key)
        apply = networks.value_network.apply
        expected = apply(normalizer, params.value, batch.observation)
        error = jnp.abs(batch.target - batch.advantage - expected).max()
        return total, told | {"error": error, "spread": jnp.std(expected)}

    monkeypatch.setattr(variants, "ppo_loss", loss)

    def update(key):
        keys = jax.random.split(key, 5)
        shape, one = (STEPS, CARS), jnp.ones((STEPS, CARS))
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
        learned = learn(SEEING, networks, inputs, optimizer, state, steps, keys[4])
        return learned, state.policy, state.value

    key = jax.random.split(jax.random.key(0), 1)
    (learned, told), *before = jax.jit(jax.vmap(update, axis_name=AXIS))(key)
    assert float(told["error"][0]) < 1e-5 < float(told["spread"][0])
    for old, new in zip(before, learned[1:3], strict=True):
        moved = jax.tree.map(lambda a, b: np.abs(a - b).max(), old, new)
        layers = moved["params"]["SetEncoder_0"]["pictures_1x4x4"]
        assert min(jax.tree.leaves(layers)) > 0.0
        assert all(np.isfinite(x).all() for x in jax.tree.leaves(new))


TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=4,
    unroll_length=8,
    num_minibatches=2,
    num_epochs=1,
    networks=NetworkConfig((16,), (16,)),
    env=EnvConfig(physics="bicycle", observation=POSES, num_agents=4, min_agents=1),
)
MADE_UP = 6


@pytest.fixture(scope="module")
def learner():
    return sliding_learner(TINY)


def made_up(learner, normalizer, policy):
    """Steps (time, agents, ...) of nobody."""
    rng, rows = np.random.default_rng(2), (TINY.unroll_length, MADE_UP)

    def normal(*size):
        return jnp.asarray(rng.normal(size=(*rows, *size)), jnp.float32)

    observation = normal(learner.env.observation_size)
    raw, log_prob = acted(learner.networks, normalizer, policy, observation, normal())
    return Minibatch(observation, raw, log_prob, normal(), normal(), jnp.ones(rows))


def test_nothing_is_learned_from_steps_without_weight(learner):
    networks = learner.networks

    @jax.jit
    def init(key):
        each = networks.policy_network, networks.value_network
        return init_normalizer(learner.inputs), *(network.init(key) for network in each)

    normalizer, policy, value = init(jax.random.key(0))
    params, batch = network_params(policy, value), made_up(learner, normalizer, policy)
    weights = Weights(entropy_cost=jnp.float32(0.0), clip=jnp.float32(0.2))
    present = np.array([True, False, True, True, False, True])
    without = jax.tree.map(lambda x: x[:, present], batch)
    spoilt = jax.tree.map(lambda x: x.at[:, ~present].multiply(-3.0), batch)
    weight = jnp.broadcast_to(jnp.float32(present), batch.advantage.shape)
    spoilt = dataclasses.replace(spoilt, weight=weight)

    @jax.jit
    def learn_from(batch):
        grad = jax.grad(ppo_loss, has_aux=True)

        def one(batch):
            key = jax.random.key(0)
            return grad(params, networks, normalizer, batch, weights, key)

        return jax.vmap(one, axis_name=AXIS)(jax.tree.map(lambda x: x[None], batch))

    expected, found = learn_from(without), learn_from(spoilt)
    for name in ("total_loss", "policy_loss", "v_loss", "kl_mean"):
        np.testing.assert_allclose(found[1][name], expected[1][name], atol=1e-6)
    assert_close(found[0], expected[0], atol=1e-6)
    assert max(np.abs(x).max() for x in jax.tree.leaves(expected[0])) > 1e-3


def test_an_update_counts_steps_of_present_agents_only(learner):
    start = learner.init()
    present = np.asarray(start.env.pipeline_state.present)
    steps = int(present.sum()) * TINY.unroll_length
    assert steps < present.size * TINY.unroll_length
    after, metrics = learner.compile()(start)
    assert count_steps(after).tolist() == [steps]
    # Of the cars in their slots those that are there: all others, all that are parked.
    agents, others = present.sum(axis=1), present.sum(axis=1) - 1
    slots = {part.group: part.count for part in learner.inputs.sets}
    cars = {
        OWN: agents.sum(),
        "agent": (agents * np.minimum(others, slots["agent"])).sum(),
        "parked_car": agents.sum() * slots["parked_car"],
    }
    assert (others < slots["agent"]).any()
    for name, statistics in after.normalizer.items():
        assert int(statistics.count.lo) == cars[name] * TINY.unroll_length
    # Paid for every step of an agent that is present, and for no other.
    paid = -TINY.env.reward.time / TINY.env.episode.max_steps
    np.testing.assert_allclose(metrics["reward/time"], paid, rtol=1e-5)
    assert int(after.skipped) == 0


def test_the_step_that_ends_an_episode_counts_if_its_agent_waits():
    """One agent, alone in an environment by hand, absent before the third step."""

    class Waits:
        def step(self, state, action):
            ended = state.pipeline_state == 1
            ends = {"episode_done": jnp.float32([ended])}
            info = state.info | ends | {"present": jnp.float32([~ended])}
            return state.replace(pipeline_state=state.pipeline_state + 1, info=info)

    steps = unrolled(Waits(), jnp.int32(0), 1, 4)
    assert steps.terminated[:, 0].tolist() == [0.0, 1.0, 0.0, 0.0]
    assert steps.weight[:, 0].tolist() == [1.0, 1.0, 0.0, 1.0]


def numbered(present, steps=3):
    """A rollout in which every number is that of its agent."""
    agents = jnp.arange(len(present), dtype=jnp.float32)
    every = jnp.broadcast_to(agents, (steps, len(present)))
    names = ("log_prob", "reward", "terminated", "truncated")
    return rollout(
        every.shape,
        **dict.fromkeys(names, every),
        observation=jnp.repeat(every[..., None], 5, axis=-1),
        raw_action=jnp.repeat(every[..., None], 2, axis=-1),
        final_observation=jnp.repeat(agents[:, None], 5, axis=-1),
        weight=jnp.broadcast_to(jnp.float32(present), every.shape),
    )


@pytest.mark.parametrize(("count", "dropped"), [(8, 0), (6, 0), (5, 0), (3, 2)])
def test_absent_agents_are_dropped_first_others_at_random(count, dropped):
    present = np.array([1, 0, 1, 1, 0, 0, 1, 1])
    drop = jax.jit(drop_absent, static_argnums=1)
    seen = set()
    for seed in range(20):
        kept, agents = drop(numbered(present), count, jax.random.key(seed))
        agents = np.asarray(agents)
        for part in (kept.observation, kept.raw_action, kept.log_prob, kept.reward):
            spread = np.asarray(part).reshape(*part.shape[:2], -1)
            np.testing.assert_array_equal(spread - agents[:, None], 0.0)
        np.testing.assert_array_equal(kept.final_observation[:, 0], agents)
        assert len(set(agents.tolist())) == count
        np.testing.assert_array_equal(kept.weight[0], present[agents])
        assert present[agents].sum() == present.sum() - dropped
        seen |= set(agents.tolist())
    assert seen >= set(np.flatnonzero(present).tolist())


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"num_agents": 8, "min_agents": 1}, 5 * 8),  # 4.5 of 8 on average
        ({"num_agents": 8, "min_agents": 8}, 64),
        ({"num_agents": 8, "min_agents": None}, 64),
    ],
)
def test_an_update_learns_of_as_many_agents_as_are_expected(changes, expected):
    env = dataclasses.replace(TINY.env, **changes)
    config = dataclasses.replace(TINY, num_lots=8, num_minibatches=8, env=env)
    assert num_learned(config, 64) == expected

"""Steps of absent agents: nothing is learned from them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State as BraxState
from helpers.learning import assert_close, rollout
from helpers.sliding import POSES, SlidePhysics

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations.compose import OWN
from carpark_mj.policy.networks import NetworkConfig, init_normalizer
from carpark_mj.training.ppo.collect import AXIS, collect, count_steps, drop_absent
from carpark_mj.training.ppo.learn import network_params, num_learned
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.variants import Minibatch, Weights, ppo_loss
from carpark_mj.wrappers.brax import BraxParking

TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=4,
    unroll_length=8,
    num_minibatches=2,
    num_epochs=1,
    networks=NetworkConfig((16,), (16,)),
    env=EnvConfig(physics="bicycle", observation=POSES, num_agents=4, min_agents=1),
)
AGENTS = 6


@pytest.fixture(scope="module")
def learner():
    learner = Learner(TINY)
    learner.env = BraxParking(ParkingEnv(TINY.env, SlidePhysics()))
    return learner


def made_up(learner, normalizer, policy) -> Minibatch:
    """Steps (time, agents, ...) of nobody."""
    rng, rows = np.random.default_rng(2), (TINY.unroll_length, AGENTS)

    def normal(*size):
        return jnp.asarray(rng.normal(size=(*rows, *size)), jnp.float32)

    distribution = learner.networks.parametric_action_distribution

    @jax.jit
    def act(observation, noise):
        apply = learner.networks.policy_network.apply
        logits = apply(normalizer, policy, observation)
        raw = distribution.sample_no_postprocessing(logits, jax.random.key(0))
        return raw, distribution.log_prob(logits, raw) + 0.1 * noise

    observation = normal(learner.env.observation_size)
    raw, log_prob = act(observation, normal())
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
            del action
            ended = state.pipeline_state == 1
            ends = {"episode_done": jnp.float32([ended])}
            info = state.info | ends | {"present": jnp.float32([~ended])}
            return state.replace(pipeline_state=state.pipeline_state + 1, info=info)

    zero, none = jnp.zeros(1), {"episode_metrics": {}, "reward_terms": {}}
    flags = {"truncation": zero, "episode_done": zero, "present": jnp.ones(1)}
    start = BraxState(jnp.int32(0), jnp.zeros((1, 1)), zero, zero, {}, flags | none)

    def act(observation, key):
        del key
        return observation, {"raw_action": observation, "log_prob": zero}

    _, steps, _ = collect(Waits(), start, act, jax.random.key(0), 4, {})
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


def agents_of(steps):
    """Which agents a rollout is of; all its arrays must agree."""
    number = np.asarray(steps.reward[0])
    for part in (steps.observation, steps.raw_action, steps.log_prob):
        spread = np.asarray(part).reshape(*part.shape[:2], -1)
        np.testing.assert_array_equal(spread - number[:, None], 0.0)
    np.testing.assert_array_equal(steps.final_observation[:, 0], number)
    return number.astype(int)


@pytest.mark.parametrize(("count", "dropped"), [(8, 0), (6, 0), (5, 0), (3, 2)])
def test_absent_agents_are_dropped_first_others_at_random(count, dropped):
    present = np.array([1, 0, 1, 1, 0, 0, 1, 1])
    drop = jax.jit(drop_absent, static_argnums=1)
    seen = set()
    for seed in range(20):
        kept, agents = drop(numbered(present), count, jax.random.key(seed))
        np.testing.assert_array_equal(agents_of(kept), agents)
        agents = np.asarray(agents)
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

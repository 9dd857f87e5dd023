"""What changes in the course of a training: schedules, rewards and starts."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig, RayConfig, SpawnConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import crash_scale, discount, training_env
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.wrappers.brax import BraxParking

PROGRESS = jnp.linspace(0.0, 1.0, 21)
SCALE = 3.0
CONFIG = PPOConfig(
    num_lots=16,
    num_steps=128_000,  # 100 updates
    unroll_length=40,
    num_minibatches=1,
    networks=NetworkConfig((8,), (8,)),
    curriculum=CurriculumConfig(crash_scale=SCALE, crash_until=0.5),
    env=EnvConfig(
        episode=EpisodeConfig(max_steps=30),
        observation=ContinuousObservation(rays=RayConfig()),
    ),
)


@pytest.mark.parametrize(
    ("end", "until", "progress", "expected"),
    [
        (3.0, 0.5, [0.0, 0.125, 0.25, 0.5, 0.75, 1.0], [1.0, 1.5, 2.0, 3.0, 3.0, 3.0]),
        (0.0, 1.0, [0.0, 0.25, 1.0], [1.0, 0.75, 0.0]),
        (4.0, 0.0, [0.0, 0.01, 1.0], [4.0, 4.0, 4.0]),
    ],
)
def test_the_crash_penalty_rises_linearly_to_its_scale(end, until, progress, expected):
    config = CurriculumConfig(crash_scale=end, crash_until=until)
    found = [crash_scale(config, jnp.float32(x)) for x in progress]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_horizon_changes_linearly_and_the_discount_with_it():
    # 100 steps until 0.3, 500 from 0.8; 200 after a quarter of the way, 300 at half.
    config = PPOConfig(discount=0.99, curriculum=CurriculumConfig(discount_end=0.998))
    progress = jnp.array([0.0, 0.3, 0.425, 0.55, 0.8, 1.0])
    found = discount(config, progress)
    horizon = np.array([100.0, 100.0, 200.0, 300.0, 500.0, 500.0])
    np.testing.assert_allclose(found, 1 - 1 / horizon, atol=1e-7)


def test_without_a_curriculum_nothing_changes():
    config = PPOConfig(discount=0.987, env=EnvConfig(spawn=SpawnConfig(0.3, 5.0, 0.1)))
    assert config.curriculum == CurriculumConfig()
    np.testing.assert_array_equal(crash_scale(config.curriculum, PROGRESS), 1.0)
    np.testing.assert_array_equal(discount(config, PROGRESS), np.float32(0.987))
    assert training_env(config) == config.env


def test_the_training_s_environment_differs_in_its_starts_only():
    ratios = {"conflict_ratio": 0.3, "reverse_ratio": 0.2, "misaligned_ratio": 0.1}
    starts = CurriculumConfig(**ratios)
    config = PPOConfig(curriculum=starts, env=EnvConfig(num_agents=3))
    env = training_env(config)
    spawn = dataclasses.replace(config.env.spawn, **ratios)
    assert env == dataclasses.replace(config.env, spawn=spawn)
    assert Learner(config).env.env.config == env
    # One of them alone leaves the others as they are in the environment.
    only = CurriculumConfig(conflict_ratio=0.3)
    env = training_env(dataclasses.replace(config, curriculum=only))
    assert env.spawn == dataclasses.replace(config.env.spawn, conflict_ratio=0.3)


@pytest.fixture(scope="module")
def unrolls():
    """The same unroll at the start and at the end of the training.

    All drive ahead, at 2.5 m/s, so that many crash.
    """
    learner = Learner(CONFIG)
    learner.env = BraxParking(ParkingEnv(CONFIG.env, SlidePhysics()))
    state, collect = learner.init(), jax.jit(learner._collect)
    ahead = jnp.array([0.0, 5.0, 0.0, 0.0])  # to the means and widths of the actions
    policy = jax.tree.map(lambda x: x + ahead if x.shape == (4,) else x, state.policy)
    found = []
    for update in (0, CONFIG.num_updates):
        now = dataclasses.replace(state, policy=policy, update=jnp.int32(update))
        found.append(jax.device_get(collect(now, jax.random.key(1))[1:]))
    return found


def test_only_the_crash_term_to_learn_from_is_scaled(unrolls):
    (start, totals), (end, same) = unrolls
    np.testing.assert_array_equal(start.observation, end.observation)
    crash = totals.reward_terms["crash"]
    assert (crash < 0).sum() >= 3
    extra = (end.reward - start.reward).sum(axis=0)
    np.testing.assert_allclose(extra, (SCALE - 1) * crash, atol=1e-5)
    penalty = (SCALE - 1) * CONFIG.env.reward.crash
    changes = np.unique((end.reward - start.reward).round(4))
    np.testing.assert_allclose(changes, [-penalty, 0.0])
    assert ((end.reward != start.reward) <= (end.terminated > 0)).all()
    # What is reported knows nothing of it.
    jax.tree.map(np.testing.assert_array_equal, totals, same)


def test_at_a_scale_of_one_the_rewards_are_the_environment_s(unrolls):
    start, totals = unrolls[0]
    reported = sum(totals.reward_terms.values())
    np.testing.assert_allclose(start.reward.sum(axis=0), reported, atol=1e-5)

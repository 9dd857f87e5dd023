"""Evaluations that several test files look at, of cars that slide."""

import jax
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig, MetricsConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import Evaluation, evaluate
from carpark_mj.layouts import StreetConfig, mixture
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.named import random_policy


def onwards(observation, key):
    """Drives ahead, swerving at random."""
    action = jax.random.uniform(key, (*observation.shape[:-1], 2), minval=-1.0)
    return action.at[..., 1].set(0.8), {}


def evaluate_onwards(metrics: MetricsConfig) -> Evaluation:
    """Ninety episodes of up to 20 steps, three agents in each of three lots."""
    config = EnvConfig(
        num_agents=3,
        num_parked_cars=10,
        episode=EpisodeConfig(max_steps=20),
        metrics=metrics,
    )
    env = ParkingEnv(config, SlidePhysics())
    return evaluate(env, onwards, num_episodes=90, seed=0, num_lots=3)


@pytest.fixture(scope="session")
def everything() -> Evaluation:
    """All that can be measured where goals are fixed."""
    return evaluate_onwards(MetricsConfig(driving=True, safety=True))


@pytest.fixture(scope="session")
def plain() -> Evaluation:
    """The same without measurements that cost time."""
    return evaluate_onwards(MetricsConfig())


@pytest.fixture(scope="session")
def mixture_env() -> ParkingEnv:
    """A mixture of a square and, half as often, streets."""
    street = StreetConfig(bays_per_side=(3, 4))
    config = EnvConfig(
        layout=mixture(["square_compact", street], [2, 1]),
        num_agents=1,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=5),
    )
    return ParkingEnv(config, SlidePhysics())


@pytest.fixture(scope="session")
def mixed(mixture_env: ParkingEnv) -> Evaluation:
    """Six episodes in the mixture."""
    return evaluate(mixture_env, random_policy(ActionSpec(2)), num_episodes=6, seed=3)

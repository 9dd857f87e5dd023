"""Evaluations that several test files look at, of cars that slide."""

import jax
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig, MetricsConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import evaluate


def evaluate_onwards(metrics):
    """Ninety episodes of up to 20 steps, three agents in each of three lots.

    They drive ahead, swerving at random.
    """

    def onwards(observation, key):
        action = jax.random.uniform(key, (*observation.shape[:-1], 2), minval=-1.0)
        return action.at[..., 1].set(0.8), {}

    config = EnvConfig(
        num_agents=3,
        num_parked_cars=10,
        episode=EpisodeConfig(max_steps=20),
        metrics=metrics,
    )
    env = ParkingEnv(config, SlidePhysics())
    return evaluate(env, onwards, num_episodes=90, seed=0, num_lots=3)


@pytest.fixture(scope="session")
def everything():
    """All that can be measured where goals are fixed."""
    return evaluate_onwards(MetricsConfig(driving=True, safety=True))


@pytest.fixture(scope="session")
def plain():
    """The same without measurements that cost time."""
    return evaluate_onwards(MetricsConfig())

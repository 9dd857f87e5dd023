"""An untrained policy, small enough to save in a moment, and its card."""

from types import SimpleNamespace

import jax

from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner

TINY = PPOConfig(
    name="secret",
    runs_dir="/somewhere",
    seed=7,
    num_lots=2,
    num_minibatches=2,
    networks=NetworkConfig((16,), (16,)),
    env=EnvConfig(physics="bicycle", num_parked_cars=4),
)


def parked_learner(config):
    """A learner for initial states only; its lots are a random number each."""
    learner = Learner(config)

    def reset(keys, *_):
        return jax.vmap(jax.random.uniform)(keys)

    learner.env = SimpleNamespace(reset=reset)
    return learner

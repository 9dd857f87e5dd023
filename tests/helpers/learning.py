"""Rollouts and states by hand, for the tests of updates."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import optax
from brax.envs.base import State as BraxState
from helpers.sliding import POSES, SlidePhysics
from jax.flatten_util import ravel_pytree

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.networks import NetworkConfig, init_normalizer
from carpark_mj.training.ppo.collect import Rollout, collect
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learn import network_params
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.wrappers.brax import BraxParking

# Compiles in seconds.
SMALL = PPOConfig(
    num_lots=2,
    unroll_length=4,
    num_minibatches=1,
    num_epochs=1,
    networks=NetworkConfig((8,), (8,)),
    env=EnvConfig(
        physics="bicycle", observation=POSES, num_agents=2, num_parked_cars=1
    ),
)


def rollout(shape, size=3, **given):
    """Steps (time, agents) in which nothing happens but what is given."""
    zero = jnp.zeros(shape)
    usual = dict.fromkeys(("log_prob", "reward", "terminated", "truncated"), zero)
    usual |= {"observation": jnp.zeros((*shape, size))}
    usual |= {"raw_action": jnp.zeros((*shape, 2))}
    usual |= {"final_observation": jnp.zeros((shape[1], size))}
    return Rollout(**(usual | given))


def acted(networks, normalizer, policy, observation, noise):
    """Raw actions of a policy, and log probabilities that are a little off."""
    distribution = networks.parametric_action_distribution

    @jax.jit
    def act(observation):
        logits = networks.policy_network.apply(normalizer, policy, observation)
        raw = distribution.sample_no_postprocessing(logits, jax.random.key(0))
        return raw, distribution.log_prob(logits, raw)

    raw, log_prob = act(observation)
    return raw, log_prob + 0.1 * noise


def begun(networks, inputs, key, update=0, **given):
    """What `learn` reads of a state, with Adam's; networks are drawn by a key."""
    keys = jax.random.split(key)
    params = network_params(
        networks.policy_network.init(keys[0]), networks.value_network.init(keys[1])
    )
    usual = {
        "update": jnp.int32(update),
        "seconds": jnp.float32(0.0),
        "normalizer": init_normalizer(inputs),
        "policy": params.policy,
        "value": params.value,
        "optimizer": optax.scale_by_adam().init(ravel_pytree(params)[0]),
    }
    return SimpleNamespace(**(usual | given))


def unrolled(env, lots, agents, steps, **more):
    """What an environment by hand gives a policy that does what it observes."""
    zero = jnp.zeros(agents)
    info = {"truncation": zero, "episode_done": zero, "present": jnp.ones(agents)}
    info |= {"episode_metrics": {}, "reward_terms": {}}
    state = BraxState(lots, jnp.zeros((agents, 1)), zero, zero, {}, info)

    def act(observation, key):
        return observation, {"raw_action": observation, "log_prob": zero}

    return collect(env, state, act, jax.random.key(0), steps, {}, **more)[1]


def sliding_learner(config, kind=Learner):
    """A learner in whose lots cars slide (`helpers.sliding`)."""
    learner = kind(config)
    learner.env = BraxParking(ParkingEnv(config.env, SlidePhysics()))
    return learner

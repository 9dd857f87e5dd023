"""Teachers: their actions where agents get to, and what they add to the loss."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, RayConfig, RingConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, init_normalizer, make_networks
from carpark_mj.training.ppo import learner as learners
from carpark_mj.training.ppo import warm_start as teachers
from carpark_mj.training.ppo.collect import AXIS
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import network_params, teacher_cost
from carpark_mj.training.ppo.variants import Minibatch, Weights, ppo_loss
from carpark_mj.training.ppo.warm_start import make_teacher

BLIND = ContinuousObservation(1, 1, rings=RingConfig(), rays=RayConfig())
KNOWS = dataclasses.replace(BLIND, lines=True)
TAUGHT = CurriculumConfig(teacher="somebody")
CONFIG = PPOConfig(
    curriculum=TAUGHT,
    env=EnvConfig(
        num_agents=2, num_parked_cars=1, physics="bicycle", observation=BLIND
    ),
)


def knows(monkeypatch, observation):
    """A teacher whose action is the end of its observation."""

    def load(name, env=None):
        assert name == "somebody"
        return SimpleNamespace(
            env=env or dataclasses.replace(CONFIG.env, observation=observation),
            policy=lambda seen, key: (seen[:, -2:], {}),
        )

    monkeypatch.setattr(teachers, "load_policy", load)


def test_a_teacher_acts_on_its_own_observation_of_the_same_lots(monkeypatch):
    knows(monkeypatch, KNOWS)
    teacher = make_teacher(CONFIG)
    assert teacher is not None
    env = ParkingEnv(dataclasses.replace(CONFIG.env, observation=KNOWS))

    def look(keys):
        lots, seen = jax.vmap(env.reset)(keys)
        return teacher(lots), seen

    advice, seen = jax.jit(look)(jax.random.split(jax.random.key(0), 3))
    np.testing.assert_allclose(advice, seen.reshape(6, -1)[:, -2:], atol=1e-6)
    assert np.std(advice) > 0.0


def collected(monkeypatch, config):
    """The options with which a training collects, and its learner."""
    monkeypatch.setattr(learners, "collect", lambda *given, **more: more)
    monkeypatch.setattr(learners, "make_policy", lambda *given, **more: None)
    names = ("normalizer", "policy", "env")
    state: Any = SimpleNamespace(
        update=jnp.int32(0), seconds=0.0, **dict.fromkeys(names)
    )
    learner = learners.Learner(config)
    found: Any = learner._collect(state, jax.random.key(0))
    return found, learner


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_training_collects_with_its_teacher_and_neighbours(monkeypatch, share):
    knows(monkeypatch, KNOWS)
    curriculum = dataclasses.replace(TAUGHT, neighbour_share=share)
    config = dataclasses.replace(CONFIG, curriculum=curriculum)
    more, learner = collected(monkeypatch, config)
    assert learner.teacher is not None
    assert more["teacher"] is learner.teacher
    assert more["with_neighbours"] == (share > 0.0)


def test_a_teacher_s_weight_falls_to_zero_and_none_has_none():
    config = dataclasses.replace(TAUGHT, teacher_cost=4.0, teacher_until=0.5)
    progress = jnp.array([0.0, 0.125, 0.5, 0.9])
    found = jnp.stack([jnp.asarray(teacher_cost(config, x)) for x in progress])
    np.testing.assert_allclose(found, [4.0, 3.0, 0.0, 0.0], atol=1e-6)
    assert make_teacher(PPOConfig()) is None
    assert teacher_cost(CurriculumConfig(), jnp.float32(0.0)) is None


def test_the_loss_counts_the_distance_of_modes_by_weight():
    networks = make_networks(
        NetworkConfig((4,), (4,), encoder="flat"),
        [Field("x", 3, -1.0, 1.0, "")],
        ActionSpec(2),
    )

    def losses(key):
        keys = jax.random.split(key, 5)
        seen, raw = jax.random.normal(keys[0], (6, 3)), jnp.ones((6, 2))
        policy = networks.policy_network.init(keys[1])
        params = network_params(policy, networks.value_network.init(keys[2]))
        advice = jax.random.uniform(keys[3], (6, 2), minval=-1.0)
        weight = jnp.array([1.0, 0.0, 1.0, 0.0, 1.0, 1.0])
        steps = Minibatch(seen, raw, -weight, weight, weight, weight, advice)
        weights = Weights(jnp.float32(0.1), jnp.float32(0.2), jnp.float32(3.0))
        normalizer = init_normalizer(ObservationSets(3))
        given = (params, networks, normalizer)
        alone = dataclasses.replace(steps, advice=None)
        totals = [
            ppo_loss(*given, batch, weights, keys[4])[0] for batch in (steps, alone)
        ]
        logits = networks.policy_network.apply(normalizer, policy, seen)
        distribution: Any = networks.parametric_action_distribution
        return totals, distribution.mode(logits), advice, weight

    key = jax.random.split(jax.random.key(1), 1)
    found = jax.jit(jax.vmap(losses, axis_name=AXIS))(key)
    (taught, alone), mode, advice, weight = jax.tree.map(lambda x: x[0], found)
    distance = (np.square(mode - advice).sum(axis=-1) * weight).sum() / weight.sum()
    assert float(taught - alone) == pytest.approx(3.0 * float(distance), rel=1e-4)

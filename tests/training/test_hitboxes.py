"""Hitboxes that are larger early in training."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.wrappers.brax import BraxParking

TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=2,
    unroll_length=8,
    num_minibatches=1,
    networks=NetworkConfig((16, 16), (16,), encoder="flat"),
    env=EnvConfig(num_agents=2, sim=SimConfig(sim_dt=0.02)),
)


def unrolls(updates, **changes):
    """What is collected for some updates from one start, and how often it compiled."""
    learner = Learner(dataclasses.replace(TINY, num_lots=8, **changes))
    learner.env = BraxParking(ParkingEnv(TINY.env, SlidePhysics()))
    start = jax.jit(learner.build)()
    collect = jax.jit(lambda state: learner._collect(state, jax.random.key(1))[2])
    totals = [collect(start.replace(update=jnp.int32(update))) for update in updates]
    return totals, collect._cache_size()


def test_hitboxes_are_scaled_until_a_number_of_agent_steps_of_training():
    # 8 lots x 2 agents x 8 steps an update: 300 steps are 3 updates, begun ones whole.
    totals, compilations = unrolls(
        (0, 2, 3, 50), num_steps=10_000, hitbox_scale=30.0, hitbox_steps=300
    )
    steps = TINY.unroll_length
    crashed = [x.episode_metrics["crashed"].mean() / steps for x in totals]
    assert crashed[0] == crashed[1] == 1.0  # boxes of 120 m
    assert crashed[2] == crashed[3] < 0.5
    assert compilations == 1


IMPOSSIBLE_HITBOXES = [
    ({"hitbox_scale": 0.0}, "hitbox_scale must be positive, not 0.0"),
    ({"hitbox_scale": 1.5}, "hitbox_scale 1.5 needs hitbox_steps of at least 1, not 0"),
    ({"hitbox_steps": -1}, "hitbox_steps must .* not -1"),
    (
        {
            "hitbox_scale": 1.5,
            "hitbox_steps": 9,
            "env": EnvConfig(num_agents=2, physics="scene"),
        },
        "hitbox_scale must be 1 in scene physics, .* not 1.5",
    ),
]


@pytest.mark.parametrize(("changes", "message"), IMPOSSIBLE_HITBOXES)
def test_impossible_hitboxes_are_refused_in_a_sentence(changes, message):
    with pytest.raises(ValueError, match=message) as caught:
        dataclasses.replace(TINY, **changes)
    assert "\n" not in str(caught.value)

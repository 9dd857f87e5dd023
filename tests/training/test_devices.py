"""Training on several devices: as on one, and with noise of their own."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers import splitting
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import StreetConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo import learner as learner_module
from carpark_mj.training.ppo.collect import AXIS
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner, num_devices
from carpark_mj.wrappers.brax import BraxParking

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_devices_learn_together_what_one_learns_from_all_their_steps(tmp_path):
    splitting.assert_alike(splitting.learned_by("brax", tmp_path / "learned.npz"))


def test_lots_and_minibatches_divide_over_the_devices_used(monkeypatch):
    monkeypatch.setattr(jax, "device_count", lambda: 6)
    config = PPOConfig(num_lots=8, num_minibatches=4, env=EnvConfig(num_agents=2))
    # 8 lots x 2 agents: 4 devices hold 4 agents each, one per minibatch; 5 and 6 do
    # not divide the lots.
    assert num_devices(config) == 4
    assert num_devices(dataclasses.replace(config, num_minibatches=16)) == 1


@pytest.mark.slow
def test_devices_with_the_same_lots_act_learn_and_draw_lots_differently(monkeypatch):
    config = PPOConfig(
        num_lots=2,
        lot_life=1,  # all are drawn anew after the update
        unroll_length=2,
        num_minibatches=1,
        networks=NetworkConfig((8,), (8,)),
        env=EnvConfig(
            layout=StreetConfig(bays_per_side=(3, 4)), num_agents=2, num_parked_cars=1
        ),
    )
    learner = Learner(config)
    learner.env = BraxParking(ParkingEnv(config.env, SlidePhysics()))

    def no_learning(config, networks, inputs, optimizer, state, rollout, key):
        learned = (state.normalizer, state.policy, state.value, state.optimizer)
        return learned, {"act": rollout.raw_action, "learn": jax.random.uniform(key)}

    monkeypatch.setattr(learner_module, "learn", no_learning)
    update = jax.vmap(learner.update, in_axes=None, axis_size=2, axis_name=AXIS)
    after, metrics = jax.jit(update)(learner.init())
    layout = after.env.pipeline_state.layout
    drawn = {
        "acts": metrics["loss/act"],
        "learns": metrics["loss/learn"],
        "lots": layout.bay_pose,
    }
    for name, (one, other) in drawn.items():
        assert (one != other).any(), name
    # What all share stays the same.
    shared = dataclasses.replace(after, env=None, key=jax.random.key_data(after.key))
    for one, other in jax.tree.leaves(shared):
        np.testing.assert_array_equal(one, other)

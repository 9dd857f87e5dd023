"""How the networks are computed in training: GPU kernel and half precision."""

import dataclasses

import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo import learner as learners
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.learner import Learner

TINY = PPOConfig(
    num_lots=2,
    unroll_length=4,
    num_minibatches=1,
    networks=NetworkConfig((16,), (16,), own_size=8, entity_size=16),
    env=EnvConfig(num_agents=2),
)


@pytest.mark.parametrize("half", [False, True])
def test_on_a_gpu_sets_are_encoded_in_the_kernel(monkeypatch, half):
    monkeypatch.setattr(learners, "has_triton", lambda: True)
    learner = Learner(dataclasses.replace(TINY, half_precision=half))
    traced = learner.compile().trace(learner.shapes())
    program = str(traced.jaxpr)
    assert "name=entities_gradient" in program
    assert ("bf16" in program) == half

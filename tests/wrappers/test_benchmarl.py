"""Algorithms of BenchMARL on the parking task."""

import math

import pytest

pytest.importorskip("benchmarl")

import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from tensordict import TensorDict

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.wrappers.benchmarl import ParkingTask, Rates, ending_rates

CONFIG = {
    "max_n_frames": 64,
    "on_policy_collected_frames_per_batch": 32,
    "on_policy_n_envs_per_worker": 4,
    "on_policy_n_minibatch_iters": 1,
    "on_policy_minibatch_size": 16,
    "off_policy_collected_frames_per_batch": 32,
    "off_policy_n_envs_per_worker": 4,
    "off_policy_n_optimizer_steps": 2,
    "off_policy_train_batch_size": 16,
    "off_policy_memory_size": 64,
    "evaluation_interval": 32,
    "evaluation_episodes": 4,
    "render": False,
    "create_json": False,
    "loggers": ["csv"],
}


@pytest.mark.filterwarnings("ignore")  # of libraries
@pytest.mark.parametrize(
    ("name", "chooses"),
    # On and off policy, of numbers and of choices, and masked.
    [("mappo", False), ("maddpg", False), ("qmix", False), ("iql", True)],
)
def test_an_algorithm_learns_by_its_name(name, chooses, tmp_path):
    config = ExperimentConfig.get_from_yaml()
    for key, value in CONFIG.items():
        setattr(config, key, value)
    config.save_folder = tmp_path
    rates = Rates()
    experiment = Experiment(
        task=ParkingTask.PARK.get_task(
            {"agents": 2, "parked_cars": 2, "physics": "bicycle"}
            | {"config": EnvConfig(goals=GoalConfig(dynamic=chooses))}
        ),
        algorithm_config=algorithm_config_registry[name].get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
        callbacks=[rates],
    )
    group = experiment.action_spec["agents", "action"]
    masks = experiment.test_env.observation_keys
    assert chooses == (("agents", "action_mask") in masks)
    discrete = name in ("iql", "qmix")
    assert group.shape == ((2,) if discrete else (2, 2))
    policy = experiment.group_policies["agents"]
    before = [p.detach().clone() for p in policy.parameters()]
    experiment.run()
    assert experiment.n_iters_performed == 2
    after = [*policy.parameters()]
    assert all(p.isfinite().all() for p in after)
    assert any((p != old).any() for p, old in zip(after, before, strict=True))
    for row in rates.history:
        assert math.isclose(row["parked"] + row["crashed"] + row["truncated"], 1.0)


def test_rates_count_every_episode_once():
    def flags(*ones):
        tensor = torch.zeros(4, 2, 1, dtype=torch.bool)
        for one in ones:
            tensor[one] = True
        return tensor

    batch = TensorDict(
        {
            ("next", "agents", "info", "parked"): flags((0, 0), (3, 1)),
            ("next", "agents", "info", "crashed"): flags((1, 1)),
            ("next", "agents", "truncated"): flags((2, 0)),
        },
        [4],
    )
    assert ending_rates(batch) == {"parked": 0.5, "crashed": 0.25, "truncated": 0.25}

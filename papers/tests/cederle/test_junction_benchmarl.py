"""BenchMARL's algorithms at the junction, small runs end to end."""

import dataclasses

import numpy as np
import pytest
from helpers.programs import rows_of

pytest.importorskip("benchmarl", reason='pip install -e ".[torchrl]"')

import jax
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs import Compose, TransformedEnv

from carpark_mj.policy import runs
from carpark_papers.cederle.adapters.torchrl import TorchRLJunction
from carpark_papers.cederle.benchmarl import train
from carpark_papers.cederle.benchmarl.build import (
    Evaluation,
    GreedyPolicy,
    HeldActions,
    make_task,
)
from carpark_papers.cederle.benchmarl.config import BenchMARLConfig, benchmarl_presets
from carpark_papers.cederle.benchmarl.train import Training, train_run
from carpark_papers.cederle.junction import JunctionEnv
from carpark_papers.cederle.junction.evaluation import NEVER
from carpark_papers.cederle.junction.rules import KEEP_LANE, SLOW_DOWN
from carpark_papers.cederle.training.evaluations import record

pytestmark = pytest.mark.filterwarnings("ignore")  # of libraries

TINY = {
    "name": "tiny",
    "hidden": (8,),
    "num_junctions": 4,
    "repeat": 1,
    "unroll": 4,
    "updates": 2,
    "batch_size": 8,
    "buffer_size": 64,
    "random_steps": 0,
    "total_steps": 48,
    "eval_period": 16,
    "eval_episodes": 2,
    "max_steps": 6,
    "video_episodes": 0,
}
# Of `cederle`, the recurrent networks of QMIX and VDN learn from whole episodes.
RECURRENT = {"recurrent": 8, "unroll": 4, "batch_size": 16}


def tiny(algorithm, tmp_path, **changes):
    config = benchmarl_presets(algorithm)["parallel"]
    return dataclasses.replace(config, runs_dir=str(tmp_path), **(TINY | changes))


@pytest.mark.parametrize(
    ("algorithm", "changes"),
    [
        ("ippo", {"shared": False}),
        ("mappo", {"action": "scalar", "scenario": "3av-hd", "repeat": 2, "unroll": 2}),
        ("maddpg", {}),
        ("vdn", RECURRENT),
        ("qmix", RECURRENT | {"scenario": "2av-hd"}),
        ("qmix", {"shared": False}),
    ],
)
def test_an_algorithm_trains_and_leaves_what_all_trainers_leave(
    algorithm, changes, tmp_path
):
    config = tiny(algorithm, tmp_path, **changes)
    folder, done = train_run(config)
    assert done
    found = rows_of(folder / "evaluations.csv")
    assert [row["env_steps"] for row in found] == ["0", "16", "32", "48"]
    metrics = rows_of(folder / "metrics.csv")
    assert [row["env_steps"] for row in metrics] == ["16", "32", "48"]
    losses = [value for name, value in metrics[-1].items() if "loss" in name]
    assert losses
    assert np.isfinite(np.array(losses, float)).all()
    for name in ("learning_curve.png", "evaluation.json", "config.json"):
        assert (folder / name).exists()


def test_a_stopped_run_goes_on_with_its_networks_and_optimisers(tmp_path):
    config = tiny("mappo", tmp_path, time_limit=1e-9)
    folder, done = train_run(config)
    assert not done
    assert len(rows_of(folder / "metrics.csv")) == 1
    resumed = dataclasses.replace(config, resume=str(folder), time_limit=0.0)
    training = Training(resumed, folder)
    assert (training.n_iters_performed, training.total_frames) == (1, 16)
    [state, *_] = training.optimizers["agents"]["loss_objective"].state.values()
    assert state["step"] > 0
    training.close()
    assert train_run(resumed) == (folder, True)
    steps = [row["env_steps"] for row in rows_of(folder / "metrics.csv")]
    assert steps == ["16", "32", "48"]
    assert len(runs.checkpoint_files(folder)) == 2
    assert train_run(resumed) == (folder, True)  # nothing is left to do


def test_a_run_that_had_finished_writes_its_video_when_resumed(tmp_path, monkeypatch):
    drives = []
    monkeypatch.setattr(
        train, "write_video", lambda _, config, act: drives.append(record(config, act))
    )
    config = tiny("mappo", tmp_path, video_episodes=2)
    folder, _ = train_run(config)
    assert train_run(dataclasses.replace(config, resume=str(folder))) == (folder, True)
    first, again = drives
    assert len(first) == len(again) == 2
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.actions, other.actions)


def test_a_held_action_is_that_of_as_many_control_steps():
    """And of fewer, if the episode ends before: 1.7 s to the crash, then nothing."""
    held = HeldActions(2, repeat=5, scenario="2av-hd", end="all", seed=0)
    single = TorchRLJunction(2, scenario="2av-hd", end="all", seed=0)
    a, b = held.reset(), single.reset()
    for choice in (0, 3, 1, 0, 0, 0, 0):
        action = torch.full((2, 2), choice)
        a = held.step(a.set(("agents", "action"), action))["next"]
        rewards = 0.0
        for _ in range(5):
            b = single.step(b.set(("agents", "action"), action))["next"]
            rewards = rewards + b["agents", "reward"].clone()
        np.testing.assert_allclose(a["agents", "reward"], rewards, rtol=1e-5)
        for name in ("observation", "terminated", "truncated"):
            np.testing.assert_allclose(a["agents", name], b["agents", name], rtol=1e-5)
    assert a["agents", "terminated"].any()


@pytest.mark.parametrize(("algorithm", "scale"), [("mappo", 20.0), ("qmix", 1.0)])
def test_ppo_learns_from_smaller_rewards_but_reports_them_as_they_are(algorithm, scale):
    task = make_task(benchmarl_presets(algorithm)["parallel"])
    env = task.get_env_fun(2, False, 0, "cpu")()
    transforms = (*task.get_env_transforms(env), task.get_reward_sum_transform(env))
    taken = TransformedEnv(env, Compose(*transforms)).rollout(8)["next", "agents"]
    assert taken["reward"].any()
    np.testing.assert_allclose(
        taken["reward"].sum(1) * scale, taken["episode_reward"][:, -1], rtol=1e-5
    )


def test_critics_of_maddpg_have_a_learning_rate_of_their_own(tmp_path):
    config = tiny("maddpg", tmp_path, learning_rate=0.25, critic_learning_rate=0.5)
    training = Training(config, tmp_path)
    rates = {
        name: optimizer.param_groups[0]["lr"]
        for name, optimizer in training.optimizers["agents"].items()
    }
    training.close()
    assert rates == {"loss_actor": 0.25, "loss_value": 0.5}


def test_greedy_episodes_are_counted_with_observations_scaled():
    config = BenchMARLConfig(eval_episodes=2, eval_jitter=0.0)
    seen = []

    def policy(step):
        seen.append(step["agents", "observation"].clone())
        action = torch.tensor([SLOW_DOWN, KEEP_LANE]).expand(2, 2)
        return step.set(("agents", "action"), action)

    first = TensorDict({"agents": TensorDict(batch_size=(2, 2))}, batch_size=2)
    outcomes = Evaluation(config)(GreedyPolicy(policy, first))
    assert (outcomes.passed[:, 0] == NEVER).all()
    assert (outcomes.passed[:, 1] < NEVER).all()
    _, observation = jax.jit(JunctionEnv().reset)(jax.random.key(0))
    np.testing.assert_allclose(seen[0][0], observation / 20.0, rtol=1e-6)


def test_the_settings_of_the_study_build(tmp_path):
    for algorithm in ("maddpg", "vdn", "qmix"):
        config = benchmarl_presets(algorithm)["cederle"]
        folder = tmp_path / algorithm
        folder.mkdir()
        training = Training(dataclasses.replace(config, buffer_size=2400), folder)
        assert training.config.off_policy_n_optimizer_steps == 1
        activations = [m for m in training.policy.modules() if isinstance(m, nn.ReLU)]
        assert len(activations) == len(config.hidden)
        training.close()

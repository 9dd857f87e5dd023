"""Stable-Baselines3: its protocol of ends, its seeds, and its learners."""

from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason='pip install -e ".[sb3]"')

from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.torch_layers import NatureCNN
from stable_baselines3.common.vec_env import VecMonitor

from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.config import EnvConfig, EpisodeConfig, RayConfig, RingConfig
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.wrappers.sb3 import ParkVecEnv

PARK, GOAL, MANY, *_ = ENTRY_POINTS
SHORT = EnvConfig(episode=EpisodeConfig(max_steps=5))


def halt(count):
    return np.zeros((count, 2), np.float32)


@pytest.mark.parametrize(("name", "options"), [(PARK, {}), (MANY, {"agents": 2})])
def test_ends_are_told_as_the_protocol_has_it(name, options):
    env = ParkVecEnv(name, 4, config=SHORT, **options)
    env.seed(0)
    env.reset()
    for _ in range(5):
        seen, _, done, infos = env.step(halt(4))
    assert done.all()
    for index, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["is_success"] is False
        assert info["terminal_observation"] in env.observation_space
        assert not np.allclose(info["terminal_observation"], seen[index])
    _, _, done, infos = env.step(halt(4))
    assert not done.any()
    assert set(infos[0]) == {"is_success", "crashed", "TimeLimit.truncated"}


def test_a_crash_is_no_truncation():
    env = ParkVecEnv(PARK, 16)
    env.seed(0)
    env.reset()
    told = []
    for _ in range(60):
        _, _, done, infos = env.step(np.tile([0.0, 1.0], (16, 1)))
        told += [infos[index] for index in np.flatnonzero(done)]
    crashes = [info for info in told if info["crashed"]]
    assert len(crashes) > 8
    assert not any(info["TimeLimit.truncated"] for info in crashes)
    assert not any(info["is_success"] for info in crashes)


def test_seeds_are_those_of_gymnasium_and_hold_for_one_reset():
    env, vector = ParkVecEnv(PARK, 3), gymnasium.make_vec(PARK, 3)
    env.seed(11)
    first = env.reset()
    np.testing.assert_array_equal(first, vector.reset(seed=11)[0])
    assert not np.array_equal(first, env.reset())
    agents = ParkVecEnv(MANY, 4, agents=2)
    agents.seed(2**32 - 3)  # the last lot's seed is beyond what fits
    assert agents.reset().shape[0] == 4


def test_pictures_are_tiled_and_videos_run_in_real_time():
    env = ParkVecEnv(PARK, 2, render_mode="rgb_array")
    assert env.metadata["render_fps"] == 5  # a control step of 0.2 s a frame
    assert "rgb_array" in env.metadata["render_modes"]
    env.reset()
    picture = env.render()
    assert picture is not None
    assert picture.shape == (2 * 540, 960, 3)
    env.close()


def test_ppo_looks_at_pictures_through_convolutions():
    cameras = CameraObservation(
        0, 0, rings=RingConfig(), rays=RayConfig(), rig="rear", width=36, height=36
    )
    config = EnvConfig(num_parked_cars=2, physics="bicycle", observation=cameras)
    env = VecMonitor(ParkVecEnv(PARK, 4, config=config))
    model = PPO("MultiInputPolicy", env, n_steps=64, batch_size=128, n_epochs=1)
    extractors: Any = model.policy.features_extractor.extractors
    before = extractors["camera_seen"].cnn[0].weight.clone()
    model.learn(256)
    for name in ("camera_depth", "camera_seen"):
        assert isinstance(extractors[name], NatureCNN)
    assert (extractors["camera_seen"].cnn[0].weight != before).any()


def test_sac_relabels_goals_and_keeps_what_crashes_cost():
    model = SAC(
        "MultiInputPolicy",
        VecMonitor(ParkVecEnv(GOAL, 4, config=SHORT)),
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"copy_info_dict": True},
        learning_starts=40,
        buffer_size=1000,
        batch_size=256,
        seed=0,
    )
    model.learn(80)
    buffer = model.replay_buffer
    assert buffer is not None
    sample = buffer.sample(256)
    achieved, desired = (
        sample.next_observations[name].numpy()
        for name in ("achieved_goal", "desired_goal")
    )
    [reward] = model.get_env().env_method(
        "compute_reward", achieved, desired, [{}], indices=[0]
    )
    paid = sample.rewards.numpy()[:, 0]
    np.testing.assert_allclose(paid, reward, atol=1e-5)  # nothing crashes in 5 steps
    at_goal = (achieved == desired).all(axis=1)
    assert at_goal.any()  # by hindsight
    np.testing.assert_array_equal(paid[at_goal], 0.0)

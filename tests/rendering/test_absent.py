"""Pictures of lots that have fewer agents than they could."""

import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.named import random_policy
from carpark_mj.rendering import recording as record_module
from carpark_mj.rendering.recording import record
from carpark_mj.rendering.web import LiveLot


@pytest.fixture(scope="module")
def env():
    config = EnvConfig(num_agents=4, min_agents=1, num_parked_cars=4)
    return ParkingEnv(config, SlidePhysics())


def test_absent_agents_are_not_recorded(env, monkeypatch):
    monkeypatch.setattr(record_module, "CHUNK", 2)
    counts = set()
    for seed in range(4):
        recording = record(env, random_policy(env.action_spec), 2, seed)
        count = recording.goal.shape[1]
        for name in ("steering", "speed", "active", "parked", "step"):
            assert getattr(recording, name).shape[1] == count
        assert recording.pose_w.shape[2] == count
        assert recording.parked_pose.shape[1] == 4
        assert recording.active.all()
        assert np.abs(recording.pose_w).max() < 100.0
        counts.add(count)
    assert len(counts) > 1


def test_absent_agents_are_not_shown_live(env):
    for seed in range(4):
        lot = LiveLot(env, random_policy(env.action_spec), seed)
        lot.step()
        assert len(lot.goal_pose) == lot.stage.num_agents < 4
        assert np.abs(lot.stage.data.qpos).max() < 100.0
        break


def test_a_live_lot_begins_as_the_video_with_its_seed(env):
    for seed in range(2):
        lot = LiveLot(env, random_policy(env.action_spec), seed)
        video = record(env, random_policy(env.action_spec), 2, seed)
        goals = np.asarray(video.layout.bay_pose)[video.goal[0]]
        np.testing.assert_array_equal(lot.goal_pose, goals)

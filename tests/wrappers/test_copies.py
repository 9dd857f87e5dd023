"""Environments are pickled and copied with their lots, also while they are shown."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from helpers.trees import same

import carpark_mj
from carpark_mj.config import EnvConfig
from carpark_mj.physics.scene import ScenePhysics
from carpark_mj.registration import ENTRY_POINTS

PARK, GOAL, *_ = ENTRY_POINTS
QUICK = EnvConfig(layout="square_compact", num_parked_cars=2, physics="bicycle")
AHEAD = np.array([0.2, 1.0], np.float32)


def pickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize(("copied", "name"), [(copy.deepcopy, GOAL), (pickled, PARK)])
def test_a_copy_goes_on_like_the_environment(copied, name):
    env = gymnasium.make(name, config=QUICK, render_mode="rgb_array")
    assert copied(env).reset(seed=1)[0] is not None  # before the first reset
    env.reset(seed=0)
    picture = env.render()
    other = copied(env)
    np.testing.assert_array_equal(other.render(), picture)
    for _ in range(3):
        assert same(env.step(AHEAD)[0], other.step(AHEAD)[0])
    other.step(AHEAD)  # on its own
    np.testing.assert_array_equal(env.unwrapped._batch.state.step, [[3]])
    env.close()
    other.close()


def test_so_does_a_copy_of_a_vector():
    vector = gymnasium.make_vec(PARK, 2, config=QUICK)
    vector.reset(seed=0)
    actions, other = np.stack([AHEAD, -AHEAD]), copy.deepcopy(vector)
    assert same(other.step(actions)[:4], vector.step(actions)[:4])


def test_so_does_a_copy_of_a_lot_of_agents():
    pytest.importorskip("pettingzoo")
    env = carpark_mj.parallel_env(config=QUICK, agents=2, render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    actions, other = dict.fromkeys(env.agents, AHEAD), pickled(env)
    assert same(other.step(actions)[0], env.step(actions)[0])


def test_a_scene_is_pickled_too():
    config = EnvConfig(num_agents=1, num_parked_cars=0, physics="scene")
    physics = pickled(carpark_mj.ParkingEnv(config)).physics
    assert isinstance(physics, ScenePhysics)
    assert physics.scene.model.nq > 0

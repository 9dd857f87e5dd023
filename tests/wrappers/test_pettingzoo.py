"""A lot as PettingZoo sees it."""

import warnings

import numpy as np
import pytest

pytest.importorskip("pettingzoo")

from pettingzoo.test import parallel_api_test, parallel_seed_test

import carpark_mj
from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.types import NO_BAY
from carpark_mj.wrappers.options import flat_action

SMALL = {"agents": 3, "parked_cars": 2, "physics": "bicycle"}


@pytest.fixture(scope="module")
def env():
    return carpark_mj.parallel_env(**SMALL)


def idle(env):
    return {agent: np.zeros(2, np.float32) for agent in env.agents}


def test_pettingzoo_accepts_the_environment_and_its_seeds(env):
    parallel_api_test(env, num_cycles=200)
    parallel_seed_test(lambda: carpark_mj.parallel_env(**SMALL), num_cycles=200)


def test_agents_leave_one_by_one_and_say_how_it_ended(env):
    env.reset(seed=1)
    assert env.agents == env.possible_agents == ["agent_0", "agent_1", "agent_2"]
    outcomes, counts = {}, []
    while env.agents:
        counts.append(len(env.agents))
        # Only the first drives, straight ahead until it hits something.
        actions = idle(env) | {a: np.float32([0, 1]) for a in env.agents[:1]}
        *_, terminated, truncated, infos = env.step(actions)
        for agent, info in infos.items():
            ended = terminated[agent] or truncated[agent]
            assert ended == (agent not in env.agents)
            assert terminated[agent] == (info["is_success"] or info["crashed"])
            if ended:
                outcomes[agent] = info
    assert outcomes.keys() == {*env.possible_agents}
    assert outcomes["agent_0"] == {"is_success": False, "crashed": True}
    assert 1 in counts
    assert counts == sorted(counts, reverse=True)
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_state_has_zeros_for_agents_that_have_left(env):
    observations, _ = env.reset(seed=1)
    np.testing.assert_array_equal(env.state(), np.concatenate([*observations.values()]))
    assert env.state_space.contains(env.state())
    before = env.state().copy()
    observations["agent_0"] -= 1.0  # arrays are the caller's own
    env.state()[:] = 2.0
    np.testing.assert_array_equal(env.state(), before)
    while "agent_0" in env.agents:
        observations, *_ = env.step(idle(env) | {"agent_0": np.float32([0, 1])})
    last = env.state().reshape(3, -1)[0]
    np.testing.assert_array_equal(last, observations["agent_0"])
    assert last.any()
    observations, *_ = env.step(idle(env))
    assert "agent_0" not in observations
    assert not env.state().reshape(3, -1)[0].any()


def test_actions_of_those_who_have_left_are_not_looked_at(env):
    poses = []
    for left in ([0.0, 1.0], [np.nan, 3.0, 0.0]):
        env.reset(seed=1)
        while "agent_0" in env.agents:
            env.step(idle(env) | {"agent_0": np.float32([0, 1])})
        env.step(idle(env) | {"agent_0": left})
        poses.append(np.asarray(env._lots.state.motion.pose_w))
    np.testing.assert_array_equal(*poses)
    with pytest.raises(AssertionError, match=r"not of \['agent_0', 'agent_1'\]"):
        env.step(dict.fromkeys(["agent_0", "agent_1"], np.zeros(2)))
    with pytest.raises(AssertionError, match="'agent_3'"):
        env.step(idle(env) | {"agent_3": np.zeros(2)})


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(3), r"Box\(-1.0, 1.0, \(2,\), float32\), not array"),
        (np.array([np.nan, 0]), r"Box\(.*, not array\(\[nan"),
        (None, r"Box\(.*, not None"),
    ],
)
def test_wrong_shapes_nan_and_infinity_are_refused(env, action, message):
    env.reset(seed=0)
    with pytest.raises(AssertionError, match=message):
        env.step(idle(env) | {"agent_1": action})


def test_dynamic_goals_have_their_own_action_space():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=2))
        small = SMALL | {"config": chosen}
        for discrete in (False, True):
            env = carpark_mj.parallel_env(**small, discrete=discrete)
            _, infos = env.reset(seed=0)
            for _ in range(2):
                tracked = np.asarray(env._lots.state.tracked_bays[0])
                space, actions = env.action_space("agent_0"), {}
                for agent, known in zip(env.agents, tracked != NO_BAY, strict=True):
                    mask = infos[agent]["action_mask"]
                    allowed = mask[:3] if discrete else mask[1][0]
                    np.testing.assert_array_equal(allowed, [1, *known])
                    actions[agent] = space.sample(mask)
                *_, infos = env.step(actions)


@pytest.mark.parametrize(
    "action", [0, (np.zeros(2),), (np.zeros(2), np.zeros(1), np.zeros(1)), np.zeros(2)]
)
def test_an_action_of_another_form_is_told_the_tuple_s_parts(action):
    spec = ActionSpec(2, (3,))
    good = (np.zeros(2, np.float32), np.array([2]))
    np.testing.assert_array_equal(flat_action(good, spec), [0.0, 0.0, 2.0])
    with pytest.raises(AssertionError, match=r"of Tuple\(Box\(.*MultiDiscrete\(\[3\]"):
        flat_action(action, spec)

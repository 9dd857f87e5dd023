"""Options of environments and of `reset`: what they set, and what is refused."""

import dataclasses
from types import SimpleNamespace

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest

import carpark_mj
from carpark_mj.config import REWARDS, EnvConfig, EpisodeConfig
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.mdp.goals import possible_choices
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.registry import SQUARE
from carpark_mj.types import NO_BAY
from carpark_mj.wrappers.options import (
    action_mask,
    action_space,
    action_table,
    configure,
    discrete_table,
    flat_action,
)


def test_options_set_fields_of_the_default_or_a_named_environment():
    same = {"layout": "square_compact", "physics": "bicycle"}
    others = {"agents": 3, "parked_cars": 5, "rule": "precise", "reward": "pose"}
    assert configure(same | others) == EnvConfig(
        **same,
        num_agents=3,
        num_parked_cars=5,
        episode=EpisodeConfig(parked_rule="precise"),
        reward=REWARDS["pose"],
    )
    assert configure({"config": "square"}) == SQUARE
    few = configure({"config": SQUARE, "agents": 2})
    assert few == dataclasses.replace(SQUARE, num_agents=2)
    assert configure({}) == EnvConfig()


def test_a_table_of_actions_has_every_choice_and_a_zero():
    table = action_table(ActionSpec(2))
    steer, pedal = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(-1, 1, 7))
    expected = np.stack([steer.T.ravel(), pedal.T.ravel()], axis=-1)
    np.testing.assert_allclose(table, expected, atol=1e-7)
    assert table.dtype == np.float32
    assert (table == 0).all(axis=1).sum() == 1  # standing still is an action
    table = action_table(ActionSpec(2, (3,)))
    assert table.shape == (231, 3)
    np.testing.assert_array_equal(table[:3, 2], [0, 1, 2])
    grid = action_table(ActionSpec(0, (3, 2)))
    assert grid.dtype == np.int32
    assert grid.tolist() == [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1]]


def test_own_rows_are_actions_or_refused():
    rows = [[0.5, -1.0, 2], [0.0, 0.0, 0]]
    table = discrete_table(ActionSpec(2, (3,)), {"discrete": rows})
    np.testing.assert_array_equal(table, rows)
    grid = discrete_table(ActionSpec(0, (3, 2)), {"discrete": [[2, 1]]})
    assert grid.dtype == np.int32
    for wrong in ([[0.0, 2.0, 0]], [[0.0, 0.0, 0.5]], [[0.0, 0.0]], [], 5, "all"):
        with pytest.raises(ValueError, match="rows of 3 numbers"):
            discrete_table(ActionSpec(2, (3,)), {"discrete": wrong})


def test_masks_are_those_of_choices_that_do_something():
    tracked = jnp.array([[NO_BAY, 3], [NO_BAY, NO_BAY]])
    choices = np.asarray(possible_choices(SimpleNamespace(tracked_bays=tracked)))
    assert choices.tolist() == [[True, False, True], [True, False, False]]
    spec = ActionSpec(2, (3,))
    table = action_table(spec)
    mask = action_mask(spec, table, choices[0])
    np.testing.assert_array_equal(mask, np.isin(table[:, 2], [0, 2]))
    for kind in (spec, ActionSpec(0, (2, 3))):
        space = action_space(kind)
        drawn = [space.sample(action_mask(kind, None, choices[0])) for _ in range(20)]
        assert {int(flat_action(action, kind)[-1]) for action in drawn} == {0, 2}
    assert possible_choices(SimpleNamespace(tracked_bays=None)) is None


PARK, GOAL, MANY, *_ = ENTRY_POINTS
QUICK = EnvConfig(
    layout="square_compact",
    num_parked_cars=4,
    physics="bicycle",
    episode=EpisodeConfig(max_steps=1),
)
# Every subset of them is another program.
START = {"pose": (1.0, -2.0, 0.5), "speed": 1.5, "goal": 7}


def begun(env, lot=0):
    """Poses, speeds and goals with which a lot has begun."""
    state = env.unwrapped._batch.state
    motion = state.motion
    return [np.asarray(x[lot]) for x in (motion.pose_w, motion.speed, state.goal)]


def assert_starts(found, pose, speed, goal):
    np.testing.assert_allclose(found[0], pose, atol=1e-5)
    np.testing.assert_allclose(found[1], speed, atol=1e-5)
    np.testing.assert_array_equal(found[2], goal)


@pytest.fixture(scope="module")
def park():
    return gymnasium.make(PARK, config=QUICK)


def test_options_set_the_start_of_one_episode(park):
    park.reset(seed=0)
    drawn = begun(park)
    park.reset(seed=0, options=START)
    assert_starts(begun(park), [START["pose"]], [1.5], [7])
    park.reset(seed=0, options={"speed": np.float32(2.0)})  # the rest is drawn as ever
    assert_starts(begun(park), drawn[0], [2.0], drawn[2])
    for nothing in (None, {}):
        park.reset(seed=0, options=nothing)
        assert_starts(begun(park), drawn[0], [0.0], drawn[2])


def test_poses_as_goals_take_them_too():
    env = gymnasium.make(GOAL, config=QUICK)
    seen, _ = env.reset(seed=0, options=START)
    x, y, yaw = START["pose"]
    vx, vy = 1.5 * np.cos(yaw), 1.5 * np.sin(yaw)
    features = x / 100, y / 100, vx / 5, vy / 5, np.cos(yaw), np.sin(yaw)
    np.testing.assert_allclose(seen["achieved_goal"], features, atol=1e-5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"goals": 3}, r"unknown option 'goals' .* \('pose', 'speed', 'goal'\)"),
        (START | {"goal": 36}, "no bay 36: .* 0 to 35"),
        ({"goal": 1.0}, "goal must be a whole number, not 1.0"),
        ({"speed": float("nan")}, "speed must be a finite number, not nan"),
        (START | {"speed": 50.0}, "speed must lie in"),
        ({"pose": (0.0, 0.0)}, "pose must be three finite numbers"),
        ({"pose": (0.0, np.nan, 0.0)}, "pose must be three finite numbers"),
        (START | {"pose": (16.4, 0.0, 0.0)}, "agent 0 of lot 0: it would touch"),
    ],
)
def test_what_cannot_be_is_refused_and_the_lot_is_as_before(park, options, message):
    park.reset(seed=0)
    before = begun(park)
    with pytest.raises(ValueError, match=message):
        park.reset(seed=1, options=options)
    assert_starts(begun(park), *before)


def test_a_vector_takes_one_for_all_or_one_for_each_and_only_now():
    vector = gymnasium.make_vec(PARK, 3, config=QUICK)
    vector.reset(seed=0, options=START)
    for lot in range(3):
        assert_starts(begun(vector, lot), [START["pose"]], [1.5], [7])
    vector.step(np.zeros((3, 2), np.float32))  # out of time: the next episodes
    assert len({tuple(begun(vector, lot)[0][0]) for lot in range(3)}) == 3
    vector.reset(seed=0)
    drawn = [begun(vector, lot) for lot in range(3)]
    vector.reset(seed=0, options=[{}, START, {"goal": 3}])
    assert_starts(begun(vector, 0), *drawn[0])
    assert_starts(begun(vector, 1), [START["pose"]], [1.5], [7])
    assert begun(vector, 2)[2] == [3]
    with pytest.raises(ValueError, match="each of the 3 environments, not 2"):
        vector.reset(options=[{}, START])
    with pytest.raises(ValueError, match="agent 0 of lot 2: "):
        vector.reset(options=[{}, START, {"goal": 99}])


def test_environments_that_share_a_lot_have_an_option_each():
    vector = gymnasium.make_vec(MANY, 4, config=QUICK, agents=2)
    vector.reset(seed=0, options=[{}, START, {"goal": 3}, {"goal": 4}])
    assert_starts([x[1] for x in begun(vector)], START["pose"], 1.5, 7)
    np.testing.assert_array_equal(begun(vector, 1)[2], [3, 4])
    with pytest.raises(ValueError, match="also another agent's goal"):
        vector.reset(options=[{}, START, {"goal": 3}, {"goal": 3}])
    with pytest.raises(ValueError, match="agent"):  # one for all, who share lots
        vector.reset(options=START)


def test_stable_baselines_options_are_those_of_each_environment():
    pytest.importorskip("stable_baselines3")
    from carpark_mj.wrappers.sb3 import ParkVecEnv

    env = ParkVecEnv(PARK, 3, config=QUICK)
    env.set_options([{}, START, {}])
    env.reset()
    assert_starts(begun(env._env, 1), [START["pose"]], [1.5], [7])
    with pytest.raises(ValueError, match="each of the 3 environments, not 1"):
        env.set_options([{}])


def test_agents_of_pettingzoo_have_options_by_name():
    pytest.importorskip("pettingzoo")
    env = carpark_mj.parallel_env(config=QUICK, agents=2)
    env.reset(seed=0, options={"agent_1": START})
    state = env._lots.state
    np.testing.assert_allclose(state.motion.pose_w[0, 1], START["pose"], atol=1e-5)
    np.testing.assert_allclose(state.motion.speed[0], [0.0, 1.5], atol=1e-5)
    assert state.goal[0, 1] == 7
    with pytest.raises(ValueError, match=r"unknown agent 'agent_2' .*'agent_1'\]"):
        env.reset(options={"agent_2": START})


def test_torchrl_takes_those_of_all_lots():
    pytest.importorskip("torchrl")
    from carpark_mj.spawning.reset_options import ResetOptions
    from carpark_mj.wrappers.torchrl import TorchRLParking

    env = TorchRLParking(2, config=QUICK, agents=1, seed=0)
    env.reset(options=ResetOptions(goal=jnp.array([[3], [4]])))
    np.testing.assert_array_equal(env._lots.batch.state.goal, [[3], [4]])

"""The Gymnasium environments: Gymnasium's own checks, and one as many."""

import copy
import dataclasses
import functools
import itertools
from concurrent.futures import ThreadPoolExecutor
from unittest import mock

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.passive_env_checker import env_render_passive_checker
from gymnasium.vector import AutoresetMode
from helpers import trees
from helpers.programs import python

from carpark_mj.config import (
    PHYSICS,
    EnvConfig,
    EpisodeConfig,
    RewardConfig,
    SensorConfig,
)
from carpark_mj.layouts import StreetConfig, mixture
from carpark_mj.observations import make_fields
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.rendering.renderer import RenderingError
from carpark_mj.rendering.stage import Stage
from carpark_mj.wrappers import batch
from carpark_mj.wrappers.gymnasium_env import one_agent
from carpark_mj.wrappers.options import observation_space

OURS = [name for name, homes in ENTRY_POINTS.items() if "carpark_mj." in homes[1]]
PARK, GOAL, MANY, FIRST = OURS
SINGLE = [PARK, GOAL]
# As many tests as can share it, with its compiled programs.
SHORT = EnvConfig(
    layout="street",
    num_parked_cars=6,
    physics="bicycle",
    episode=EpisodeConfig(max_steps=20),
)
COUNT = 4  # of environments side by side
AHEAD = np.array([0.0, 1.0], np.float32)


def make(name=PARK, **options):
    return gymnasium.make(name, **options).unwrapped


# Single and batched programs may round differently.
assert_close = functools.partial(trees.assert_close, atol=1e-4)


@pytest.mark.parametrize(
    ("name", "options"), [*((name, {"config": SHORT}) for name in SINGLE), (FIRST, {})]
)
def test_gymnasium_finds_no_fault(name, options):
    # It would open a window as well; pictures are looked at below.
    env = make(name, **options)
    check_env(env, skip_render_check=True)  # a warning is an error here


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (PARK, {"physics": "mjx"}),
        (GOAL, {"config": SHORT}),
        (PARK, {"layout": mixture(["square", "tpcap"]), "parked_cars": 0}),
        pytest.param(
            PARK,
            {"config": "hope", "layout": "hope_extreme_parallel"},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_observations_keep_to_their_space(name, options):
    vector = gymnasium.make_vec(name, 16, **{"physics": "bicycle"} | options)
    observation, _ = vector.reset(seed=1)
    vector.action_space.seed(1)
    for step in range(200):
        assert observation in vector.observation_space
        actions = vector.action_space.sample()
        actions[0] = (0.2, 1.0) if step < 40 else (0.0, -1.0)
        actions[1] = (0.0, 1.0)
        actions[2] = (0.0, -1.0)
        observation, *_ = vector.step(actions)


MODES = [(PARK, mode, True) for mode in AutoresetMode]


@pytest.mark.parametrize(
    ("name", "mode", "details"), [*MODES, (GOAL, AutoresetMode.SAME_STEP, False)]
)
def test_many_are_as_gymnasium_s_own_vector_of_one_each(name, mode, details):
    """With all that they say of ended episodes, and resets of a mask.

    Resets have seeds or not; noise draws a key every step.
    """
    noisy = dataclasses.replace(SHORT, sensors=SensorConfig(position_noise=0.1))
    options = {"config": noisy, "details": details}
    others = [lambda: gymnasium.make(name, **options)] * COUNT
    own = gymnasium.make_vec(name, COUNT, **options, autoreset_mode=mode.value)
    theirs = gymnasium.vector.SyncVectorEnv(others, autoreset_mode=mode)
    assert own.metadata["autoreset_mode"] is mode
    own.action_space.seed(0)
    mask = np.array([True, False, False, True])
    resets = {0: {"seed": 4}, 25: {"seed": 9, "options": {"reset_mask": mask}}}
    done, crashes = np.zeros(COUNT, bool), 0

    def check(infos, told):
        assert {*infos} == {*told}
        for key in told.keys() - {"final_obs", "final_info"}:
            known = told.get(f"_{key}", np.ones(COUNT, bool))  # others may be anything
            assert_close([infos[key][known]], [told[key][known]])
        if "final_info" in told:
            check(infos["final_info"], told["final_info"])
            for index in np.flatnonzero(told["_final_obs"]):
                assert_close(infos["final_obs"][index], told["final_obs"][index])

    def both(call):
        (seen, *one, infos), (expected, *other, told) = call(own), call(theirs)
        assert_close(seen, expected)
        assert_close(one, other)
        check(infos, told)
        for leaf in jax.tree.leaves(seen):
            leaf[:] = np.nan  # the caller's own
        return *one, infos

    for step in range(45):  # two ends of time and more
        if step in resets:
            both(lambda env: env.reset(**copy.deepcopy(resets[step])))  # noqa: B023
            done[:] = False
        if mode is AutoresetMode.DISABLED and done.any():
            ended = done.copy()
            both(lambda env: env.reset(options={"reset_mask": ended}))  # noqa: B023
        actions = own.action_space.sample()
        actions[:3] = (0.3, 1.0), (0.0, 1.0), (-0.3, 1.0)  # into something
        _, terminated, truncated, infos = both(lambda env: env.step(actions))  # noqa: B023
        done = terminated | truncated
        crashes += infos.get("final_info", infos)["crashed"].sum()
    assert terminated.shape == (COUNT,)
    assert crashes


GARAGE = EnvConfig(
    layout="garage_row",
    num_agents=4,
    min_agents=4,
    occupancy=(0.0, 0.5),
    num_parked_cars=4,
    physics="bicycle",
    episode=EpisodeConfig(max_steps=5),
)


def test_agents_of_many_share_lots_and_begin_alone():
    vector = gymnasium.make_vec(MANY, 8, config=GARAGE)
    observation, _ = vector.reset(seed=2)
    assert observation.shape == vector.observation_space.shape
    assert vector.num_lots == 2
    state = vector.unwrapped._batch.state  # none is an absent agent
    assert state.present is None or state.present.all()
    assert (state.goal >= 0).all()
    for _ in range(5):
        seen, _, _, truncated, infos = vector.step(np.zeros((8, 2), np.float32))
    assert truncated.all()
    final = np.stack(infos["final_obs"])
    assert final.shape == seen.shape
    assert not np.isclose(final, seen).all(axis=1).any()
    seen, *_ = vector.step(np.zeros((8, 2), np.float32))
    second = np.arange(8) >= 4
    after, _ = vector.reset(seed=3, options={"reset_mask": second})
    np.testing.assert_array_equal((after == seen).all(axis=1), ~second)
    with pytest.raises(ValueError, match="all agents of a lot"):
        vector.reset(options={"reset_mask": np.arange(8) >= 3})
    with pytest.raises(ValueError, match="same step"):
        gymnasium.make_vec(MANY, 8, config=GARAGE, autoreset_mode="NextStep")


def test_discrete_actions_are_rows_of_a_table():
    """The standard one, or own rows, of one and of many."""
    rows = [[0.5, 1.0], [0.0, -1.0]]
    own = make(config=SHORT, discrete=rows)
    check_env(own, skip_render_check=True)
    many = gymnasium.make_vec(PARK, 2, config=SHORT, discrete=rows)
    numbers = make(config=SHORT)
    for env in (own, numbers):
        env.reset(seed=1)
    many.reset(seed=[1, 1])
    for row in (0, 0, 1):
        one, *_ = own.step(row)
        assert_close(one, numbers.step(np.float32(rows[row]))[0])
        seen, *_ = many.step(np.array([row, 1 - row]))
        assert_close(seen[0], one)
    assert (seen[0] != seen[1]).any()
    assert make(config=SHORT, discrete=True).action_space.n == 77
    for wrong in (2, -1, 0.5):
        with pytest.raises(ValueError, match="integers from 0 to 1"):
            own.step(wrong)


def test_details_say_where_the_car_is_and_what_each_term_paid():
    env = make(config=SHORT, details=True)
    _, info = env.reset(seed=3)
    start = info["pose"]
    assert not any(value for key, value in info.items() if key[:7] == "reward_")
    for _ in range(3):
        _, reward, _, _, info = env.step(AHEAD)
    state, paid = env._batch.state, [x for k, x in info.items() if k[:7] == "reward_"]
    np.testing.assert_allclose(np.sum(paid), reward, atol=1e-6)
    np.testing.assert_array_equal(info["pose"], state.motion.pose_w[0, 0])
    assert (info["pose"] != start).any()
    goal = state.layout.parked_pose[0, int(state.goal[0, 0])]
    np.testing.assert_array_equal(info["goal"], goal)
    away = info["pose"] - info["goal"]
    assert info["goal_distance"] == pytest.approx(np.hypot(*away[:2]), abs=1e-5)
    assert abs(np.sin(away[2])) == pytest.approx(np.sin(info["goal_heading"]), abs=1e-5)


def test_max_episode_steps_is_the_time_limit():
    longer = dataclasses.replace(SHORT, episode=EpisodeConfig(max_steps=30))
    options = {"max_episode_steps": 20, "config": longer, "physics": "bicycle"}
    env = gymnasium.make(PARK, **options)
    env.reset(seed=0)
    steps = next(n for n in itertools.count(1) if env.step(0.0 * AHEAD)[3])
    assert steps == env.spec.max_episode_steps == 20  # and not 30
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    vector = gymnasium.make_vec(PARK, 2, **options)
    assert again.spec.max_episode_steps == vector.spec.max_episode_steps == 20
    # One environment, whose rewards may be shares of the time limit.
    lots = env.unwrapped._batch.env
    assert lots is again.unwrapped._batch.env is vector._batch.env
    for options in ({}, {"max_episode_steps": -1}):  # -1: no `TimeLimit`
        env = gymnasium.make(PARK, config=SHORT, **options)
        assert env.spec.max_episode_steps == 20
        assert env.unwrapped._batch.env.config.episode == one_agent(SHORT).episode


@pytest.mark.parametrize("name", SINGLE)
def test_a_spec_with_configs_survives_json(name):
    options = {"config": SHORT, "layout": mixture(["lot", StreetConfig()], [2, 1])}
    if name == PARK:
        reward = RewardConfig(extra={"person": 2.0})
        options |= {"reward": reward, "physics": PHYSICS["bicycle"]}
    env = gymnasium.make(name, **options)
    again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped._batch.env is env.unwrapped._batch.env
    vector = gymnasium.make_vec(name, 2, **options)
    again = gymnasium.make_vec(EnvSpec.from_json(vector.spec.to_json()))
    assert again.unwrapped._batch.env is vector._batch.env


def test_an_ended_episode_needs_a_reset():
    env = make(config=SHORT)
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(AHEAD)
    env.reset(seed=0)
    while not any(env.step(AHEAD)[2:4]):
        pass
    with pytest.raises(ResetNeeded, match="call reset"):
        env.step(AHEAD)
    env.reset()
    env.step(AHEAD)


def test_only_what_grows_beyond_the_lot_has_wider_bounds():
    def box(**change):
        return observation_space(EnvConfig(num_agents=1, **change))

    fields = make_fields(EnvConfig(num_agents=1))
    names = np.repeat([f.name for f in fields], [f.size for f in fields])
    lot, street = box(layout="square_compact"), box(layout="tpcap_3", num_parked_cars=4)
    assert np.isfinite(street.high).all()
    assert {*names[street.high > lot.high]} >= {"goal_position", "goal_distance"}
    same = {"speed", "steering", "goal_heading", "goal_near", "in_bay", "yaw_rate"}
    assert not same & {*names[street.high > lot.high]}
    noisy = box(layout="square_compact", sensors=SensorConfig(position_noise=0.1))
    assert not (same - {"speed", "yaw_rate"}) & {*names[np.isinf(noisy.high)]}
    assert "goal_position" in names[np.isinf(noisy.high)]


def test_pictures_show_the_lot_and_what_has_moved_in_any_thread():
    env = make(render_mode="rgb_array", config=SHORT, width=320, height=200)
    env.reset(seed=0)
    before = env.render()
    assert before.shape == (200, 320, 3)
    assert before.std() > 10
    with ThreadPoolExecutor(1) as other:
        np.testing.assert_array_equal(other.submit(env.render).result(), before)
        np.testing.assert_array_equal(env.render(), before)  # the first is as the next
        other.submit(env.close).result()
    np.testing.assert_array_equal(env.render(), before)
    env.step(AHEAD)
    env.step(AHEAD)
    assert np.abs(env.render().astype(int) - before).max() > 50
    env.reset(seed=1)  # another street
    other_lot = env.render()
    assert np.abs(other_lot.astype(int) - before).mean() > 1
    np.testing.assert_array_equal(env.render(), other_lot)
    env_render_passive_checker(env)
    env.close()
    env.close()


def test_each_lot_has_a_picture_of_a_scene_built_once(monkeypatch):
    built = mock.Mock(wraps=Stage)
    monkeypatch.setattr(batch, "Stage", built)
    options = {"config": SHORT, "render_mode": "rgb_array"}
    vector = gymnasium.make_vec(PARK, COUNT, **options)
    vector.reset(seed=0)
    pictures = vector.render()
    np.testing.assert_array_equal(vector.render(), pictures)
    assert built.of.call_count == COUNT
    vector.reset(seed=[0, 5, 2, 3])
    others = vector.render()
    assert built.of.call_count == COUNT + 1
    vector.close()
    np.testing.assert_array_equal(others[0], pictures[0])
    assert (np.diff([*pictures, others[1]], axis=0) != 0).any(axis=(1, 2, 3)).all()


def test_a_window_without_a_display_is_refused(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = make(render_mode="human", config=SHORT)
    with pytest.raises(RenderingError, match=r"no display .*'rgb_array' needs none"):
        env.reset(seed=0)


def test_a_window_shows_every_step(monkeypatch):
    window = mock.Mock()
    monkeypatch.setattr("carpark_mj.wrappers.batch.missing_display", lambda: None)
    monkeypatch.setattr("mujoco.viewer.launch_passive", lambda *_: window)
    env = make(render_mode="human", config=SHORT)
    env.reset(seed=0)
    env.step(AHEAD)
    assert env.render() is None
    env.close()
    assert (window.sync.call_count, window.close.call_count) == (2, 1)


def test_import_registers_ids_and_loads_no_simulator():
    code = (
        "import sys, carpark_mj, gymnasium\n"
        "print(*sorted(n for n in gymnasium.registry if n[:7] == 'carpark'))\n"
        "print({'jax', 'mujoco', 'torch'} & {*sys.modules})"
    )
    done = python("-W", "error", "-c", code)
    assert done.stdout.splitlines() == [" ".join(sorted(OURS)), "set()"]

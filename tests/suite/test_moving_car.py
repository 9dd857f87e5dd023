"""A car that drives through the aisle of hard cases while another one parks."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import box_distance
from carpark_mj.policy.acting import StatePolicy
from carpark_mj.suite.evaluation import CaseEvaluator, suite_env
from carpark_mj.suite.levels import GAP, HOPE_LEVELS, pick_cases
from carpark_mj.suite.tpcap import TPCAP_CAR

SIZE = np.array(TPCAP_CAR.size)
SECONDS, DT = 60.0, 0.2
GOES, WAITS, IS_HIT = range(3)  # the lots of `drives`
BEFORE = 6.0  # m between the bumpers of two cars that face each other


@pytest.mark.parametrize("level", HOPE_LEVELS)
def test_every_held_out_case_has_room_for_it(level):
    layouts = pick_cases(level, 1000, with_moving_car=True).layouts
    alone = pick_cases(level, 1000)
    start, goal = (np.asarray(x)[:, 1] for x in (layouts.spawn_pose, layouts.bay_pose))
    np.testing.assert_allclose(start * [-1, 1, 1], goal, atol=1e-5)
    # In two cases one way, in the next two the other; forwards.
    way = np.tile([1.0, 1.0, -1.0, -1.0], 250)
    np.testing.assert_array_equal(np.sign(goal[:, 0]), way)
    np.testing.assert_allclose(np.cos(goal[:, 2]), way, atol=1e-6)
    reach = goal[:, 0] * way + SIZE[0] / 2
    assert (reach < np.asarray(layouts.extent)[:, 0]).all()
    # What it drives over keeps clear of everything solid, and of the goal.
    swept = np.stack([2 * reach, np.full(1000, SIZE[1])], axis=-1)
    middle = goal * [0, 1, 1]

    def clearance(pose, size, mask=True):
        found = box_distance(middle[:, None], swept[:, None], pose, size)
        return np.where(mask, found, np.inf).min()

    walls = layouts.wall_pose, layouts.wall_size, layouts.wall_mask
    assert clearance(*walls) >= GAP - 1e-3
    assert clearance(layouts.bay_pose[:, :1], layouts.bay_size[:, :1]) > GAP
    first = layouts.spawn_pose[:, 0]
    assert box_distance(start, SIZE, first, SIZE).min() >= 3.5
    # Nothing else of the case changes.
    names = [name for name in vars(layouts) if name.startswith(("bay", "spawn"))]
    first = {name: getattr(layouts, name) for name in names}
    first = {name: x[:, :1] for name, x in first.items() if x is not None}
    same = dataclasses.replace(layouts, **first)
    jax.tree.map(np.testing.assert_array_equal, same, alone.layouts)


@pytest.fixture(scope="module")
def drives():
    """Rows and drives of three lots where the other car has parked, stands, attacks."""
    config = suite_env(EnvConfig(), "strict", with_moving_car=True)
    short = dataclasses.replace(config.episode, max_steps=round(SECONDS / DT))
    env = ParkingEnv(dataclasses.replace(config, episode=short))
    cases = pick_cases("normal", 3, with_moving_car=True)
    layouts = cases.layouts
    own = layouts.spawn_pose.at[GOES, 0].set(layouts.bay_pose[GOES, 0])
    own = own.at[WAITS, 0].set(own[WAITS, 1] * jnp.array([0.0, 1.0, 1.0]))
    towards = jnp.array([-1.0, 0.0, 0.0]) * (BEFORE + SIZE[0])  # it comes from +x
    facing = own[IS_HIT, 1] + towards - jnp.array([0.0, 0.0, jnp.pi])
    own = own.at[IS_HIT, 0].set(facing)
    cases = cases._replace(layouts=dataclasses.replace(layouts, spawn_pose=own))

    def policy(observation, key):
        del key
        assert observation.shape == (3, env.observation_size)  # one car a lot
        return jnp.zeros((3, 2)).at[IS_HIT, 1].set(1.0), {}

    rows, driven = CaseEvaluator(env).drive(policy, cases, seed=0)
    return cases, rows, driven


def way_of(drives, lot):
    """The moving car's way from its start (t,) and its offset (t,) [m]; its speed."""
    cases, _, driven = drives
    start = np.asarray(cases.layouts.spawn_pose)[lot, 1]
    moved = driven.pose_w[lot, :, 1, -1] - start
    return moved[:, 0] * np.cos(start[2]), moved[:, 1], driven.speed[lot, :, 1]


def test_it_drives_straight_at_1_m_s_and_stays_at_its_goal(drives):
    cases, rows, _ = drives
    assert rows[GOES]["parked"] == 1.0
    along, offset, speed = way_of(drives, GOES)
    whole = 2 * float(cases.layouts.bay_pose[GOES, 1, 0])
    assert np.abs(offset).max() < 0.01
    arrived = np.argmax(along > whole - 0.5)
    assert arrived * DT == pytest.approx(whole / 1.0, rel=0.1)
    np.testing.assert_allclose(speed[10 : arrived - 1], 1.0, atol=0.06)
    assert along[-1] == pytest.approx(whole, abs=0.3)
    assert np.abs(speed[-20:]).max() < 0.01


def test_it_waits_for_a_car_backs_off_and_tries_again(drives):
    _, rows, driven = drives
    assert rows[WAITS]["timed_out"] == 1.0
    assert rows[WAITS]["path"] < 0.01  # nobody has pushed it
    along, _, speed = way_of(drives, WAITS)
    pose = driven.pose_w[WAITS, :, :, -1]
    gap = np.asarray(box_distance(pose[:, 0], SIZE, pose[:, 1], SIZE))
    assert 0.2 < gap.min() < 1.0
    stands = 10 + np.argmax(np.abs(speed[10:]) < 0.05)
    leaves = stands + np.argmax(speed[stands:] < -0.1)
    assert (leaves - stands) * DT == pytest.approx(5.0, abs=1.0)
    back = leaves + np.argmax(speed[leaves:] > 0.5)
    assert -0.3 < along[back] < 1.0
    assert gap[back:].min() < 1.0
    assert along.min() > -0.5


def test_a_car_that_drives_into_it_has_hit_it(drives):
    _, rows, _ = drives
    row = rows[IS_HIT]
    assert (row["crashed"], row["hit_agent"], row["hit_wall"]) == (1.0, 1.0, 0.0)
    # Both speed up at 1 m/s²; from 1 s on the moving car does not, and it stops 1 m
    # before the end: t²/2 + t - 1/2 = 6 m gives 2.7 s.
    assert row["length"] * DT == pytest.approx(2.7, abs=0.4)
    # It stays where it was hit.
    along, _, _ = way_of(drives, IS_HIT)
    np.testing.assert_array_equal(along[20:], along[20])


def test_a_state_policy_drives_the_parking_car_only():
    seen = []

    def act(state):
        jax.debug.callback(lambda x: seen.append((*x.tolist(),)), state.active)
        return jnp.zeros((2, 2))

    env = ParkingEnv(suite_env(EnvConfig(), "strict", with_moving_car=True))
    cases = pick_cases("normal", 1, with_moving_car=True)
    CaseEvaluator(env).decision_time(StatePolicy(act), cases)
    jax.effects_barrier()
    assert {*seen} == {(True, False)}

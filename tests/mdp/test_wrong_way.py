"""Driving against the lanes: who does, and what it costs."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.lanes import EAST, NORTH, PLAN, SOUTH, WEST
from helpers.scenes import cars, lot, moved_cars, moved_lot, polygons
from helpers.sliding import POSES, SlidePhysics, placed

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.progress import drives_wrong_way

wrong_way_jit = jax.jit(drives_wrong_way)
CASES = [
    ((0.0, -1.5, EAST), 1.0, False),  # on the right
    ((0.0, -1.5, WEST), 1.0, True),  # a ghost driver
    ((0.0, 1.5, WEST), 1.0, False),
    ((0.0, 1.5, EAST), 1.0, True),
    ((0.0, 1.5, WEST), -1.0, True),  # reversing counts by where the car goes
    ((0.0, 1.5, EAST), -1.0, False),
    ((0.0, 1.5, EAST), 0.04, False),  # as good as standing
    ((0.0, 1.5, EAST), 0.06, True),
    ((0.0, 1.5, math.radians(61.0)), 1.0, False),  # 119 deg off: it crosses
    ((0.0, 1.5, math.radians(59.0)), 1.0, True),  # 121 deg off
    ((0.0, 1.5, math.radians(-59.0)), 1.0, True),
    ((0.0, 0.0, EAST), 1.0, False),  # on the line, in both lanes
    ((0.0, 0.0, WEST), 1.0, False),
    ((0.0, 3.5, EAST), 1.0, False),  # outside every lane
    ((10.0, 8.0, NORTH), 1.0, False),
    ((10.0, 8.0, SOUTH), 1.0, True),
    ((10.0, 1.5, WEST), 1.0, False),  # on the crossing either lane may allow it
    ((10.0, 1.5, NORTH), 1.0, False),
    ((10.0, 1.5, EAST), 1.0, False),  # the aisle's lane is crossed squarely
    ((10.0, 1.5, math.radians(-45.0)), 1.0, True),  # against both
    ((-10.0, -8.0, NORTH), 1.0, False),
    ((-10.0, -8.0, SOUTH), 1.0, False),
]


def case_cars():
    return cars([pose for pose, _, _ in CASES], speed=[speed for _, speed, _ in CASES])


@pytest.mark.parametrize("motion", [(0.0, 0.0, 0.0), (7.0, -12.0, 2.3)])
def test_wrong_way_is_motion_that_no_lane_there_allows(motion):
    # The case on the line between the lanes cannot survive rounding.
    keep = [case[0][1] != 0.0 or motion[2] == 0.0 for case in CASES]
    layout = moved_lot(PLAN, motion)
    got = np.asarray(wrong_way_jit(layout, moved_cars(case_cars(), motion)))
    wrong = [c for c, g, k in zip(CASES, got, keep, strict=True) if k and g != c[2]]
    assert wrong == []
    unmarked = PLAN.replace(lane_mask=jnp.zeros(4, bool))  # padding is no lane
    assert not wrong_way_jit(unmarked, case_cars()).any()
    assert drives_wrong_way(lot([(0.0, 0.0, 0.0)]), case_cars()) is None  # never lanes


@pytest.mark.parametrize("name", ["street", "angled", "lot", "garage_row"])
def test_only_driving_back_in_a_lane_is_wrong(name):
    layout = make_layout(name)
    rows = np.flatnonzero(layout.lane_mask)
    pose = np.asarray(layout.lane_pose)[rows]
    there = wrong_way_jit(layout, cars(pose, speed=1.0))
    back = np.asarray(wrong_way_jit(layout, cars(pose, speed=-1.0)))
    assert not there.any()
    # Another lane of the crossing may allow it, which shapely tells.
    inside = shapely.covers(
        polygons(layout.lane_pose, layout.lane_size), shapely.points(pose[:, None, :2])
    )
    alone = (inside & np.asarray(layout.lane_mask)).sum(axis=1) == 1
    assert alone.any()
    one_way = np.asarray(layout.lane_one_way)[rows]
    np.testing.assert_array_equal(back[alone], one_way[alone])


def street_env(layout):
    """One sliding car, alone in a lot."""
    config = EnvConfig(
        layout=layout,
        num_agents=1,
        num_parked_cars=0,
        episode=EpisodeConfig(max_steps=10),
        observation=POSES,
    )
    return ParkingEnv(config, SlidePhysics())


@pytest.fixture(scope="module")
def street():
    env = street_env("street")
    return env, jax.jit(env.reset)(jax.random.key(0))[0], jax.jit(env.step)


@pytest.mark.parametrize("wrong", [False, True])
def test_the_metric_is_the_way_driven_against_the_lane(street, wrong):
    env, state, step = street
    lane = np.asarray(state.layout.lane_pose[0])
    yaw = lane[2] + (math.pi if wrong else 0.0)
    state = placed(env, state, [(lane[0], lane[1], yaw)])
    metres = []
    for _ in range(10):  # 0.05 m each
        state, timestep = step(state, jnp.array([[0.0, 0.1]]))
        metres.append(float(timestep.metrics["wrong_way"][0]))
    way = 0.05 * np.arange(1, 11) * wrong
    np.testing.assert_allclose(metres, way, atol=1e-5)  # float32 at some 10 m
    assert bool(timestep.events.timed_out[0])
    assert float(state.stats.wrong_way[0]) == 0.0  # it starts anew with the episode


def test_a_lot_without_lanes_has_no_metric():
    env = street_env("square")
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    assert not state.layout.has_lanes
    shapes = jax.eval_shape(env.step, state, jnp.zeros((1, 2)))[1]
    assert "wrong_way" not in shapes.metrics

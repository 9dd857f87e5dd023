"""Actions that enter a step, driving against the lanes, what is seen at the end."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.lanes import EAST, NORTH, PLAN, SOUTH, WEST
from helpers.scenes import cars, fields_of, lot, moved_cars, moved_lot
from helpers.sliding import POSES, placed, sliding

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    GoalConfig,
    RingConfig,
    SensorConfig,
    insert,
)
from carpark_mj.mdp.actions import action_spec, parse
from carpark_mj.mdp.progress import drives_wrong_way
from carpark_mj.observations import ContinuousObservation

NAN, INF = np.nan, np.inf
CHOOSING = EnvConfig(goals=GoalConfig(dynamic=True, num_tracked_bays=3))


@pytest.mark.parametrize(
    ("action", "sanitized", "invalid"),
    [
        ([0.3, -0.7], [0.3, -0.7], False),
        ([1.0, -1.0], [1.0, -1.0], False),
        ([NAN, 0.5], [0.0, 0.5], True),
        ([0.5, NAN], [0.5, 0.0], True),
        ([INF, -INF], [1.0, -1.0], True),
        ([1.0001, 0.0], [1.0, 0.0], True),
        ([0.0, -7.0], [0.0, -1.0], True),
    ],
)
def test_nan_becomes_zero_and_the_rest_is_clipped(action, sanitized, invalid):
    actions = jnp.array([action, [0.1, 0.2]], jnp.float32)
    controls, choice, flagged = jax.jit(parse, static_argnums=0)(EnvConfig(), actions)
    np.testing.assert_array_equal(controls[0], np.float32(sanitized))
    assert choice is None
    assert flagged.tolist() == [invalid, False]


@pytest.mark.parametrize(
    ("index", "sanitized", "invalid"),
    [
        (0, 0, False),
        (3, 3, False),
        (4, 3, True),
        (-1, 0, True),
        (INF, 3, True),
        (NAN, 1, True),  # of 0 to 3 the lower of both in the middle
        (1.4, 1, True),
        (1.6, 2, True),
    ],
)
def test_invalid_index_becomes_the_nearest_and_nan_the_middle(
    index, sanitized, invalid
):
    actions = jnp.array([[0.1, 0.2, index], [0.1, 0.2, 1]], jnp.float32)
    controls, choice, flagged = parse(CHOOSING, actions)
    np.testing.assert_array_equal(controls, actions[:, :2])
    assert choice.dtype == jnp.int32
    assert choice.tolist() == [sanitized, 1]
    assert flagged.tolist() == [invalid, False]


@pytest.mark.parametrize("config", [EnvConfig(), CHOOSING])
def test_the_middle_of_the_ranges_is_a_valid_action(config):
    spec = action_spec(config)
    assert spec.middle.shape == (spec.size,)
    assert spec.middle.dtype == spec.dtype
    assert not parse(config, spec.middle[None]).invalid.any()


def test_environment_sanitizes_actions_and_counts_them():
    _, reset, step = sliding(EnvConfig(num_agents=3, num_parked_cars=0))
    state, _ = reset(jax.random.key(0))
    wild = jnp.array([[NAN, 0.5], [0.2, 9.0], [0.2, 0.5]])
    tame = jnp.array([[0.0, 0.5], [0.2, 1.0], [0.2, 0.5]])
    got, timestep = step(state, wild)
    expected, plain = step(state, tame)
    np.testing.assert_array_equal(got.motion.pose_w, expected.motion.pose_w)
    np.testing.assert_array_equal(timestep.reward, plain.reward)
    np.testing.assert_array_equal(timestep.metrics["invalid_actions"], [1, 1, 0])
    assert not plain.metrics["invalid_actions"].any()
    assert not timestep.events.done.any()
    _, timestep = step(got, wild)
    np.testing.assert_array_equal(timestep.metrics["invalid_actions"], [2, 2, 0])


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


def alone(layout):
    """One sliding car in a lot, with its compiled functions."""
    return sliding(
        EnvConfig(
            layout=layout,
            num_agents=1,
            num_parked_cars=0,
            episode=EpisodeConfig(max_steps=10),
            observation=POSES,
        )
    )


@pytest.mark.parametrize("wrong", [False, True])
def test_the_metric_is_the_way_driven_against_the_lane(wrong):
    env, reset, step = alone("street")
    state, _ = reset(jax.random.key(0))
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
    env, _, _ = alone("square")
    state, _ = jax.eval_shape(env.reset, jax.random.key(0))
    assert state.stats.wrong_way is None
    shapes = jax.eval_shape(env.step, state, jnp.zeros((1, 2)))[1]
    assert "wrong_way" not in shapes.metrics


MAX_STEPS = 6
CONFIG = EnvConfig(
    num_agents=4,
    num_parked_cars=8,
    episode=EpisodeConfig(max_steps=MAX_STEPS, final_observation=True),
    observation=ContinuousObservation(rings=RingConfig((5.0, 12.0), 9, True, 2)),
    sensors=SensorConfig(
        position_noise=0.1, heading_noise=0.02, speed_noise=0.1, delay_max=2
    ),
)


def start(env, reset):
    """A lot in which agent 0 times out in the next step, 1 parks and 2 hits a wall.

    With dynamic goals only agent 0 is done.
    """
    state, _ = reset(jax.random.key(4))  # agent 0 tracks a free bay
    pose = np.array([[-6.0, 0, 0], [0, 0, 0], [0, 6, 0], [6.0, 3.0, 1.0]], np.float32)
    if not env.config.goals.dynamic:
        pose[1] = state.layout.bay_pose[state.goal[1]]
        pose[2, :2] = state.layout.wall_pose[4, :2]
    state = placed(env, state, pose)
    return state.replace(step=jnp.array([MAX_STEPS - 1, 2, 2, 0], jnp.int32))


ACTION = np.float32([[0.3, 0.5], [0.0, 0.0], [0.0, 0.0], [-0.2, 0.4]])


def test_final_observation_is_that_without_respawn():
    env, reset, step = sliding(CONFIG)
    _, _, stay = sliding(insert(CONFIG, {"episode.respawn": False}))
    state = start(env, reset)
    for _ in range(2):  # sensors and rings get a past
        state, _ = step(state.replace(step=jnp.zeros(4, jnp.int32)), ACTION / 100)
    state = start(env, reset).replace(sensors=state.sensors, memory=state.memory)
    after, timestep = step(state, ACTION)
    _, expected = stay(state, ACTION)
    done = np.asarray(timestep.events.done)
    assert timestep.events.timed_out.tolist() == [True, False, False, False]
    assert timestep.events.parked.tolist() == [False, True, False, False]
    assert timestep.events.crashed.tolist() == [False, False, True, False]
    final = np.asarray(timestep.final_observation)
    np.testing.assert_array_equal(final, expected.observation)
    seen = np.asarray(timestep.observation)
    assert (final[done] != seen[done]).any(axis=1).all()
    # Rings that agents still have a past of, which the new episodes have not.
    named, begun = fields_of(final, env.config), fields_of(seen, env.config)
    past = [name for name in named if "_ago_" in name]
    assert len(past) == 4
    assert any(named[name][done].any() for name in past)
    assert not any(begun[name][done].any() for name in past)
    assert (after.step == jnp.where(done, 0, 1)).all()


def test_final_observation_ignores_the_time_limit():
    """The goal chosen in the step, and the bays tracked from where the car stands."""
    env, reset, step = sliding(
        dataclasses.replace(CONFIG, goals=GoalConfig(dynamic=True))
    )
    state = start(env, reset)
    action = np.concatenate([ACTION, np.ones((4, 1), np.float32)], axis=1)
    _, timestep = step(state, action)
    _, expected = step(state.replace(step=jnp.zeros(4, jnp.int32)), action)
    assert timestep.events.timed_out[0]
    assert not expected.events.done.any()
    final = timestep.final_observation
    np.testing.assert_array_equal(final[0], expected.observation[0])
    assert (np.asarray(final[0]) != np.asarray(timestep.observation[0])).any()
    named = fields_of(final, env.config)
    assert named["goal_position"][0].any()

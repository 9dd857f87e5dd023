import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.observing import CONFIGS, observe_jit
from helpers.scenes import cars, fields_of, lot
from helpers.sliding import placed, sliding
from helpers.states import config_of, parked_at, state_of
from helpers.trees import agent_of, same

from carpark_mj.config import (
    EnvConfig,
    RayConfig,
    RingConfig,
    SensorConfig,
    ShareConfig,
)
from carpark_mj.layouts import build
from carpark_mj.layouts.routes import make_routes
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.sensors import (
    init_sensors,
    measure,
    observed,
    reckon,
    reset,
)
from carpark_mj.types import Odometry

KEY = jax.random.key(0)
LATE = SensorConfig(delay_min=2, delay_max=2)
LOT = lot([(0.0, 0.0, 0.0)])


def standing(count, x=0.0):
    pose = np.zeros((count, 3), np.float32)
    pose[:, 0] = x
    return cars(pose)


def lot_with(sensors, motion=None, **parameters):
    motion = standing(1) if motion is None else motion
    return state_of(LOT, motion, 0, sensors=sensors, **parameters)


def seen_by(sensors, motion):
    """The motion as the agents know it."""
    return observed(state_of(LOT, motion, 0, sensors=sensors))


def test_a_respawned_agent_has_new_sensors_without_a_past():
    config = SensorConfig(delay_min=1, delay_max=3)
    sensors = init_sensors(config, standing(200, 0.0), KEY)
    sensors = measure(config, lot_with(sensors), standing(200, 1.0), KEY)
    respawned = jnp.arange(200) % 2 == 0
    there = standing(200, 5.0)
    after = reset(config, sensors, there, respawned, jax.random.key(1))
    fresh = init_sensors(config, there, jax.random.key(1))
    assert same(agent_of(after, np.s_[::2]), agent_of(fresh, np.s_[::2]))
    assert same(agent_of(after, np.s_[1::2]), agent_of(sensors, np.s_[1::2]))
    np.testing.assert_array_equal(seen_by(after, there).xy[::2, 0], 5.0)
    assert set(np.asarray(after.delay[::2])) == {1, 2, 3}


ODOMETRY = SensorConfig(odometry_scale=0.01, odometry_veer=2e-3, odometry_turn=0.02)
DT = 0.2  # s, the control step
AHEAD = 1.25  # m, the centre of a car made by hand from its rear axle


def reckoned(poses, error):
    """What a car believes that drives over true poses (k, 3), and where it is."""
    odometry = Odometry(jnp.array(poses[0]), jnp.array(error))
    for before, after in itertools.pairwise(poses):
        step = jnp.array(before), jnp.array(after), jnp.array(AHEAD)
        odometry = reckon(odometry, *step)
    return np.asarray(odometry.pose_w)


def circle(radius, angles):
    """Centres of a car whose rear axle runs about the origin, to the left."""
    x, y = radius * np.sin(angles), -radius * np.cos(angles)
    rear = np.stack([x, y, angles], axis=-1)
    ahead = AHEAD * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    return (rear + ahead).astype(np.float32)


def test_odometry_drifts_as_its_wheels_err():
    straight = np.zeros((11, 3), np.float32)
    straight[:, 0] = np.linspace(0.0, 10.0, 11)
    quarter = circle(5.0, np.linspace(0.0, np.pi / 2, 21))
    # Right wheels are right, turning and both ways; float32.
    for poses in straight, quarter, quarter[::-1]:
        np.testing.assert_allclose(reckoned(poses, [0, 0, 0]), poses[-1], atol=1e-5)
    # 10 m are 10.2 m, there and back is where it began.
    believed = reckoned(straight, [0.02, 0, 0])
    np.testing.assert_allclose(believed, [10.2, 0, 0], atol=1e-5)
    back = np.concatenate([straight, straight[-2::-1]])
    np.testing.assert_allclose(reckoned(back, [0.02, 1e-3, 0]), 0.0, atol=1e-5)
    # 1e-3 rad/m: after 10 m the heading is off by 0.01, the rear axle on a circle.
    yaw = 0.01
    x, y = 1e3 * np.sin(yaw) - AHEAD, 1e3 * (1 - np.cos(yaw))
    expected = [x + AHEAD * np.cos(yaw), y + AHEAD * np.sin(yaw), yaw]
    believed = reckoned(straight, [0, 1e-3, 0])
    np.testing.assert_allclose(believed, expected, atol=1e-4)
    # 2 % of a quarter turn are 1.8 degrees, on a circle that much tighter.
    believed = reckoned(quarter, [0, 0, 0.02])
    yaw, radius = 1.02 * np.pi / 2, 5.0 / 1.02
    rear = [radius * np.sin(yaw), -5.0 + radius * (1 - np.cos(yaw))]
    expected = [rear[0] + AHEAD * np.cos(yaw), rear[1] + AHEAD * np.sin(yaw), yaw]
    np.testing.assert_allclose(believed, expected, atol=3e-3)  # chords of 4.5 degrees


def test_cars_observe_where_they_believe_to_be_from_known_starts():
    start = cars(np.zeros((4000, 3)))
    sensors = init_sensors(ODOMETRY, start, KEY)
    assert sensors is not None
    np.testing.assert_array_equal(seen_by(sensors, start).pose_w, start.pose_w)
    end = cars(np.tile(np.array([10.0, 0.0, 0.0]), (4000, 1)))
    after = measure(ODOMETRY, lot_with(sensors, start), end, KEY)
    believed = np.asarray(seen_by(after, end).pose_w)
    # 4000 samples: standard errors of 1.1 %.
    assert (believed[:, 0] - 10.0).std() == pytest.approx(0.1, rel=0.05)
    assert believed[:, 2].std() == pytest.approx(0.02, rel=0.05)
    assert init_sensors(LATE, start, KEY).odometry is None
    respawned = jnp.arange(4000) < 2000
    fresh = reset(ODOMETRY, after, start, respawned, jax.random.key(1))
    np.testing.assert_array_equal(fresh.odometry.pose_w[:2000], 0.0)
    np.testing.assert_array_equal(fresh.odometry.pose_w[2000:], believed[2000:])
    assert (fresh.odometry.error[:2000] != after.odometry.error[:2000]).all()


def test_delay_compensation_tells_where_late_cars_are_now():
    def at(step):
        """Cars that drive a circle ever faster, to the left."""
        yaw, rate = 0.05 * step**2, 0.1 * step / DT
        pose = np.tile(circle(5.0, np.array([yaw])), (200, 1))
        return cars(pose, 5.0 * rate, 0.1 * step, rate)  # the rear axle's

    config = SensorConfig(delay_max=3)
    sensors = init_sensors(config, at(0), KEY)
    for step in range(4):
        sensors = measure(config, lot_with(sensors, at(step)), at(step + 1), KEY)
    late = lot_with(sensors, at(4), step=jnp.full(200, 4))
    exact = dataclasses.replace(late, sensors=None)
    plain = config_of(ContinuousObservation())
    env = config_of(ContinuousObservation(delay_compensation=True))
    known, seen = env.observation.known(env, late), observed(late)
    for name in ("pose_w", "velocity_b", "yaw_rate", "steering"):
        true = getattr(late.motion, name)
        # Chords instead of arcs of up to 0.35 rad.
        np.testing.assert_allclose(getattr(known, name), true, atol=0.015)
        off = np.abs(getattr(seen, name) - true).reshape(200, -1).max(axis=1)
        np.testing.assert_array_equal(off > 0.05, sensors.delay > 0)
    begun = env.observation.known(env, dataclasses.replace(late, step=jnp.zeros(200)))
    np.testing.assert_allclose(begun.pose_w, seen.pose_w, atol=1e-5)
    truth = observe_jit(env, exact)
    np.testing.assert_allclose(observe_jit(env, late), truth, atol=0.02)
    assert np.abs(observe_jit(plain, late) - truth).max() > 0.2


def test_noise_has_the_configured_spread_and_no_bias():
    config = SensorConfig(position_noise=0.1, heading_noise=0.02, speed_noise=0.3)
    motion = cars(np.full((20_000, 3), 1.0), speed=2.0, yaw_rate=0.4, steering=0.1)
    seen = seen_by(init_sensors(config, motion, KEY), motion)
    errors = np.c_[seen.pose_w - 1.0, seen.velocity_b - jnp.array([2.0, 0.0])].T
    for error, spread in zip(errors, (0.1, 0.1, 0.02, 0.3, 0.3), strict=True):
        # 20,000 samples: standard errors of 0.5 % (spread) and 0.7 % of it (mean).
        assert float(error.std()) == pytest.approx(spread, rel=0.03)
        assert abs(float(error.mean())) < 0.03 * spread
    np.testing.assert_array_equal(seen.yaw_rate, motion.yaw_rate)
    np.testing.assert_array_equal(seen.steering, motion.steering)
    np.testing.assert_array_equal(seen.trace_w, motion.trace_w)


# Two aisles and the road between them, bays at both, pillars and walls.
AISLES = build.assemble(
    (40.0, 40.0),
    build.lanes(
        [(0.0, -8.0, 0.0), (0.0, 8.0, math.pi), (10.0, 0.0, math.pi / 2)],
        [(24.0, 5.0), (24.0, 5.0), (20.0, 5.0)],
    ),
    build.bays([(x, y, math.pi / 2) for y in (-3.0, 13.0) for x in (-8, -4, 0, 4)], 3),
    build.walls([(-13.0, 0.0, 1.0), (2.0, 4.0, 0.2), (14.0, -4.0, 0.0)], (1.0, 4.0)),
    build.discs([(-3.0, 5.0), (6.0, -2.0)], [0.4, 0.6]),
)
EVERYTHING = ContinuousObservation(
    tracked_agents=2,
    tracked_parked_cars=2,
    rings=RingConfig((6.0, 9.0), cars=True),
    share=ShareConfig(steering=True, priority=True),
    lines=True,
    own_car=True,
    rays=RayConfig(8, near=4.0),
)
FIXED = EnvConfig(
    observation=dataclasses.replace(EVERYTHING, route=True, global_information=True),
    num_agents=5,
)
CHOSEN = config_of(
    dataclasses.replace(EVERYTHING, share=ShareConfig(), global_information=True),
    3,
    num_agents=5,
)


def scattered(seed):
    """Five cars all over the lot, one of them 0.2 m off the middle of bay 0."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform([-12, -12, -3.0], [12, 12, 3.0], (5, 3))
    pose[0] = [-8.0 + rng.uniform(-0.2, 0.2), -3.2, math.pi / 2 + 0.1]
    speed, steering, yaw_rate = rng.uniform(-0.4, 0.4, (3, 5))
    return cars(pose, 3.0 * speed, steering, yaw_rate)


SCENES = [
    *(config_of(observation, num_agents=5) for observation in CONFIGS),
    FIXED,
    CHOSEN,
    config_of(CONFIGS[-1], 3, num_agents=5),
]


def late_scene(config):
    """Fields with late sensors, if all were where these say, and with exact ones."""
    believed, true = scattered(0), scattered(1)
    bays = [[k, (k + 1) % 8, (k + 3) % 8] for k in range(5)]

    def seen(motion, sensors=None):
        more = {"sensors": sensors, "parked_cars": parked_at(AISLES.bay_pose[5:8])}
        more["tracked_bays"] = bays if config.goals.dynamic else None
        more["routes"] = make_routes(AISLES) if config.follows_routes else None
        state = state_of(AISLES, motion, jnp.arange(5), **more)
        return fields_of(observe_jit(config, state), config)

    late = init_sensors(SensorConfig(delay_min=1, delay_max=1), believed, KEY)
    return seen(true, late), seen(believed), seen(true)


# Numbers that cannot be the same in the two scenes, of everybody who reads poses.
READ = {
    *("speed", "steering", "yaw_rate", "goal_position", "goal_near", "goal_heading"),
    *("goal_distance", "in_bay", "line_room", "route_next", "route_length"),
    *("goal_nearest_agent", "goal_claim", "agent_0_position", "agent_0_heading"),
    *("agent_0_speed", "agent_0_goal", "agent_0_steering", "parked_car_0_position"),
    *("parked_car_0_heading", "bay_0_position", "bay_0_distance"),
    *("bay_0_nearest_agent", "bay_0_claim", "ring_9m", "rays", "rays_near"),
}


def test_observations_follow_measured_poses_not_the_true_ones():
    read = set()
    for config in SCENES:
        found, expected, truly = late_scene(config)
        for name, value in expected.items():
            np.testing.assert_array_equal(found[name], value, err_msg=name)
            if name in READ and config in (FIXED, CHOSEN):
                assert not np.array_equal(found[name], truly[name]), name
                read.add(name)
    assert read == READ


def test_memory_of_rings_and_tracking_of_others_follow_them_too():
    rings = RingConfig((9.0,), cap=9, cars=True, history=1)
    seen = ContinuousObservation(tracked_agents=1, tracked_parked_cars=1, rings=rings)
    believed, true = scattered(0), scattered(1)
    late = init_sensors(SensorConfig(delay_min=1, delay_max=1), believed, KEY)
    parked = parked_at(AISLES.bay_pose[4:8])
    memory = {"rings": jnp.zeros((5, 1, 1), jnp.int32)}

    def facts(motion, sensors=None):
        more = {"sensors": sensors, "memory": memory, "parked_cars": parked}
        state = state_of(AISLES, motion, jnp.arange(5), **more)
        tracks = [read(state) for read in (seen.tracks_agents, seen.tracks_parked_cars)]
        return [seen.remember(state)["rings"], *tracks]

    views = facts(true, late), facts(believed), facts(true)
    for found, expected, truly in zip(*views, strict=True):
        np.testing.assert_array_equal(found, expected)
        assert not np.array_equal(found, truly)


SLIDING = EnvConfig(num_agents=2, num_parked_cars=2, sensors=LATE)


def test_judging_rewards_and_motion_ignore_the_sensors():
    noisy = SensorConfig(position_noise=3.0, heading_noise=1.0, delay_max=3)
    runs = []
    for sensors in (SensorConfig(), noisy):
        env, reset, step = sliding(dataclasses.replace(SLIDING, sensors=sensors))
        state, _ = reset(KEY)
        pose = [[-5.0, 0.0, 0.0], [5.0, 0.0, 1.0]]
        state = placed(env, state, pose).replace(goal=jnp.array([0, 1]))
        _, timestep = step(state, jnp.array([[0.1, 0.5], [0.0, -0.5]]))
        runs.append(timestep)
    truth, run = runs
    np.testing.assert_array_equal(truth.reward, run.reward)
    np.testing.assert_array_equal(truth.motion.pose_w, run.motion.pose_w)
    for name in truth.metrics:
        np.testing.assert_array_equal(truth.metrics[name], run.metrics[name])


def test_late_sensors_start_afresh_after_a_respawn():
    env, reset, step = sliding(SLIDING)
    state, _ = reset(KEY)
    # Far from everything, so that nothing ends the episode.
    state = placed(env, state, [[-4.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    ahead = jnp.array([[0.0, 1.0], [0.0, 1.0]])
    speeds = []
    for _ in range(4):
        state, timestep = step(state, ahead)
        assert not timestep.events.done.any()
        named = fields_of(timestep.observation, env.config)
        speeds.append(float(named["speed"][0, 0]))
    limit = env.vehicle.max_speed
    # Slides at 2.5 m/s from the first step; seen two steps later.
    assert speeds == pytest.approx([0.0, 0.0, 2.5 / limit, 2.5 / limit])
    over = state.replace(step=jnp.full(2, env.config.episode.max_steps, jnp.int32))
    after, timestep = step(over, ahead)
    assert timestep.events.done.all()
    seen = observed(after)
    np.testing.assert_array_equal(seen.pose_w, after.motion.pose_w)
    np.testing.assert_array_equal(seen.speed, [0.0, 0.0])

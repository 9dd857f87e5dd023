"""The environment's contract, one test per sentence.

Steps are worked by hand on sliding cars (`helpers.sliding`).
"""

import copy
import dataclasses
import pickle
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import check_occupancy, fields_of
from helpers.sliding import APART, HALT, MAX_STEPS, in_goal, placed, slide, start
from helpers.trees import agent_of, leaves, same

from carpark_mj.config import (
    EnvConfig,
    GivingWayConfig,
    GoalConfig,
    GoalRewards,
    RandomizationConfig,
    RewardConfig,
    SensorConfig,
    SpawnConfig,
    insert,
    is_data,
    setting,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.observations.fields import FAR
from carpark_mj.types import ENDINGS

# Reset


def test_reset_is_a_function_of_the_key():
    _, reset, _ = slide()
    assert same(reset(jax.random.key(3)), reset(jax.random.key(3)))
    one, other = reset(jax.random.key(3))[0], reset(jax.random.key(4))[0]
    assert not same(one.goal, other.goal)
    assert not same(one.motion.pose_w, other.motion.pose_w)
    assert not same(one.key, other.key)


# Step


def test_outside_jit_programs_compile_once_and_agree_with_jit():
    env, reset, step = slide()
    key = jax.random.key(0)

    def drive():
        state, seen = env.reset(key)
        return (
            state,
            seen,
            env.reset_to_layout(state.layout, key),
            env.step(state, HALT),
        )

    state, seen = reset(key)
    assert same(drive(), (state, seen, (state, seen), step(state, HALT)))
    compiled = []
    listen = lambda event, *_, **__: compiled.append(event)  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    drive()
    jax.monitoring.unregister_event_duration_listener(listen)
    assert not any("compile" in event for event in compiled)
    assert pickle.loads(pickle.dumps(env)).config == env.config
    for other in (copy.copy(env), env.with_values({})):  # programs of their own
        assert other._compiled is not env._compiled


def test_step_is_pure():
    env, step, state = start()
    before, constants = leaves(state), dict(vars(env))
    action = np.float32([[0.5, 1.0], [0.0, -1.0], [-1.0, 0.3]])
    first, second = step(state, action), step(state, action)
    assert same(first, second)
    assert all(map(np.array_equal, before, leaves(state)))
    assert vars(env) == constants


def ending(kind, respawn=True):
    """A step in which agent 1 ends its episode in the given way."""
    env, step, state = start(respawn)
    action = HALT.copy()
    if kind == "parked":
        state = in_goal(env, state, 1)
    if kind == "crashed":
        pose = APART.copy()
        pose[1, :2] = state.layout.wall_pose[4, :2]
        state = placed(env, state, pose)
    if kind == "timed_out":
        state = state.replace(step=jnp.array([0, MAX_STEPS - 1, 0], jnp.int32))
    if kind == "diverged":
        physics = state.physics.replace(speed=jnp.array([0.0, jnp.nan, 0.0]))
        state = state.replace(physics=physics)
    return env, state, *step(state, action)


@pytest.mark.parametrize("kind", ENDINGS)
def test_parking_and_crashing_terminate_others_truncate(kind):
    _, _, _, timestep = ending(kind)
    for name in ENDINGS:
        expected = [False, name == kind, False]
        np.testing.assert_array_equal(getattr(timestep.events, name), expected)
    terminal = kind in ("parked", "crashed")
    np.testing.assert_array_equal(timestep.terminated, [False, terminal, False])
    np.testing.assert_array_equal(timestep.truncated, [False, not terminal, False])
    np.testing.assert_array_equal(timestep.metrics[kind], [0.0, 1.0, 0.0])


@pytest.mark.parametrize("kind", ENDINGS)
def test_an_agent_whose_episode_ends_respawns_alone(kind):
    _, before, after, _ = ending(kind)
    np.testing.assert_array_equal(after.step, [before.step[0] + 1, 0, 1])
    # The others stay where they stand; agent 1 is in the spawn region, at rest.
    np.testing.assert_array_equal(after.motion.pose_w[::2], before.motion.pose_w[::2])
    half = float(before.layout.spawn_size[0, 0]) / 2
    assert (np.abs(after.motion.pose_w[1, :2]) <= half).all()
    assert not np.array_equal(after.motion.pose_w[1], before.motion.pose_w[1])
    assert after.motion.finite.all()
    assert not np.any(leaves(agent_of(after.stats, 1)))
    # It has a goal of its own, never the old one; the others keep theirs.
    same_goal = np.asarray(after.goal == before.goal)
    np.testing.assert_array_equal(same_goal, [True, False, True])
    mask = np.asarray(after.layout.bay_mask)
    check_occupancy(after.goal, after.parked_cars.bay, mask)


@pytest.mark.parametrize("kind", ENDINGS)
def test_a_parked_car_moves_into_the_bay_or_off_a_new_goal(kind):
    _, before, after, _ = ending(kind)
    old, new = (np.asarray(state.parked_cars.bay) for state in (before, after))
    if kind == "parked":
        assert before.goal[1] in np.setdiff1d(new, old)
    else:
        np.testing.assert_array_equal(old != new, old == int(after.goal[1]))


@pytest.mark.parametrize("kind", ENDINGS)
def test_the_time_step_shows_the_motion_before_the_respawn(kind):
    _, before, _, timestep = ending(kind)
    np.testing.assert_array_equal(timestep.motion.pose_w, before.motion.pose_w)
    distance = np.linalg.norm(
        before.motion.pose_w[:, :2] - before.layout.bay_pose[before.goal][:, :2], axis=1
    )
    # Metrics are of the episode that ended, with its goal.
    np.testing.assert_allclose(timestep.metrics["final_distance"], distance, atol=1e-5)


def test_after_a_respawn_the_observation_is_of_the_new_episode():
    env, _, after, timestep = ending("crashed")
    named = fields_of(timestep.observation, env.config)
    goal = np.asarray(after.layout.bay_pose[after.goal])
    distance = np.linalg.norm(after.motion.pose_w[:, :2] - goal[:, :2], axis=1)
    np.testing.assert_allclose(named["goal_distance"][:, 0], distance / FAR, atol=1e-6)
    # The others see the newcomer where it has respawned.
    gap = np.linalg.norm(
        after.motion.pose_w[:, :2] - after.motion.pose_w[0, :2], axis=1
    )
    seen = np.linalg.norm(named["agent_0_position"][0]) * FAR
    assert seen == pytest.approx(np.sort(gap)[1], abs=1e-5)  # float32


def test_two_agents_may_end_in_one_step_and_get_different_goals():
    env, step, state = start()
    pose = APART.copy()
    pose[1] = pose[0]
    crash = placed(env, state, pose)
    for seed in range(20):
        after, timestep = step(crash.replace(key=jax.random.key(seed)), HALT)
        np.testing.assert_array_equal(timestep.terminated, [True, True, False])
        check_occupancy(
            after.goal, after.parked_cars.bay, np.asarray(after.layout.bay_mask)
        )
        gap = np.linalg.norm(np.diff(after.motion.pose_w[:2, :2], axis=0))
        assert gap > 3.0


@pytest.mark.parametrize("shape", [(), (2,), (1, 2), (3, 1)])
def test_an_action_of_another_shape_is_refused(shape):
    env = ParkingEnv(EnvConfig(num_agents=3, num_parked_cars=0, physics="bicycle"))
    state, _ = jax.eval_shape(env.reset, jax.random.key(0))
    message = r"action must be of shape \(3, 2\), not "
    with pytest.raises(ValueError, match=message + re.escape(str(shape))):
        jax.eval_shape(env.step, state, jnp.zeros(shape))


def settings(config, prefix=""):
    """The values of all settings by their paths."""
    found = {}
    for field in dataclasses.fields(config):
        path, value = prefix + field.name, getattr(config, field.name)
        nested = dataclasses.is_dataclass(value)
        found |= settings(value, f"{path}.") if nested else {path: value}
    return found


@pytest.mark.parametrize("dynamic", [False, True])
def test_every_setting_that_is_data_can_be_traced(dynamic):
    noise = ("position_noise", "heading_noise", "speed_noise", "odometry_scale")
    shares = {"close_ratio": 0.2, "conflict_ratio": 0.2}
    pay, scheme = GoalRewards(stop_goal=-0.05), GivingWayConfig("L,L,A")
    changes = {"goals": GoalConfig(dynamic=True), "giving_way": scheme}
    changes["reward"] = RewardConfig(goals=pay)
    if not dynamic:
        shares |= {"reverse_ratio": 0.2, "misaligned_ratio": 0.2}
        changes = {}
    config = dataclasses.replace(
        slide()[0].config,
        sensors=SensorConfig(**dict.fromkeys(noise, 0.1)),
        spawn=SpawnConfig(**shares),
        randomization=RandomizationConfig(mass=(0.9, 1.1), steering_lag=(0.0, 0.1)),
        physics="bicycle",
        **changes,
    )
    env = ParkingEnv(config)
    data = {p: v for p, v in settings(config).items() if is_data(config, p)}
    assert {"reward.reeds_shepp_reach", "reward.closeness", "episode.hitbox_scale"} < {
        *data
    }
    assert {f"sensors.{name}" for name in noise} < {*data}
    assert {f"spawn.{name}" for name in shares} < {*data}
    assert {"randomization.mass", "randomization.steering_lag"} < {*data}
    # What is off is no part of the program.
    assert not {"sensors.odometry_turn", "randomization.friction"} & {*data}

    def step(values):
        traced = env.with_values(values)
        state, _ = traced.reset(jax.random.key(0))
        action = jnp.zeros((3, env.action_spec.size))
        return traced.step(state, action)[1].reward

    values = {path: jnp.float32(value) for path, value in data.items()}
    assert jax.eval_shape(step, values).shape == (3,)


def test_traced_numbers_start_episodes_as_settings_do():
    """Their shares, parameters of cars and noise, in resets and respawns."""
    one, other = (
        insert(
            EnvConfig(num_agents=1, num_parked_cars=0, physics="bicycle"),
            {
                "episode.max_steps": 2,
                "spawn.close_ratio": close,
                "spawn.reverse_ratio": 0.5,
                "sensors.position_noise": noise,
                "randomization.mass": mass,
            },
        )
        for close, noise, mass in ((0.1, 0.5, (1.0, 2.0)), (0.5, 0.01, (1.5, 1.6)))
    )
    paths = ("spawn.close_ratio", "sensors.position_noise", "randomization.mass")
    keys, action = jax.random.split(jax.random.key(0), 32), jnp.zeros((1, 2))

    def drive(env):
        def lot(key):
            begun, seen = state, _ = env.reset(key)
            for _ in range(2):
                state, timestep = env.step(state, action)
            cars = (x.physics.vehicle.mass for x in (begun, state))
            return seen, timestep.observation, *cars

        return jax.vmap(lot)(keys)

    env = ParkingEnv(one)
    traced = jax.jit(lambda values: drive(env.with_values(values)))
    values = {path: jnp.array(setting(other, path), jnp.float32) for path in paths}
    fixed = ParkingEnv(other)
    expected = jax.jit(lambda: drive(fixed))()
    for found, wanted in zip(traced(values), expected, strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-4)
    assert (expected[2] != expected[3]).all()  # others drive other cars
    own = {path: jnp.array(setting(one, path), jnp.float32) for path in paths}
    assert not np.allclose(traced(own)[1], expected[1], atol=1e-2)
    assert traced._cache_size() == 1


# Without respawning


def test_without_respawning_finished_agents_are_frozen_for_ever():
    # Agent 1 runs out of time at full speed and stops dead there.
    _, step, state = start(respawn=False)
    state = state.replace(step=jnp.array([0, MAX_STEPS - 1, 0], jnp.int32))
    state, timestep = step(state, np.float32([[0, 0], [0.5, 1.0], [0, 0]]))
    np.testing.assert_array_equal(timestep.events.timed_out, [False, True, False])
    assert float(timestep.motion.speed[1]) > 0.0
    np.testing.assert_array_equal(state.active, [True, False, True])
    assert float(timestep.reward[1]) != 0.0  # its last step still counts
    physics, pose = agent_of(state.physics, 1), np.asarray(state.motion.pose_w[1])
    # Agents 0 and 2 turn on the spot, agent 1 asks for anything.
    for k in range(MAX_STEPS - 1):
        action = np.float32([[1.0, 0.0], [(-1) ** k, 1.0], [-1.0, 0.0]])
        state, timestep = step(state, action)
        assert same(agent_of(state.physics, 1), physics)
        np.testing.assert_array_equal(state.motion.pose_w[1], pose)
        np.testing.assert_array_equal(state.motion.trace_w[1], [pose] * 4)
        np.testing.assert_array_equal(state.motion.velocity_b[1], 0.0)  # as others see
        assert float(state.motion.yaw_rate[1]) == 0.0
        assert float(timestep.reward[1]) == 0.0
        assert not timestep.events.done[1]
        assert (timestep.reward[::2] != 0.0).all()
    np.testing.assert_array_equal(timestep.events.timed_out, [True, False, True])
    assert not state.active.any()
    state, timestep = step(state, HALT + 1.0)
    np.testing.assert_array_equal(timestep.reward, 0.0)
    assert not timestep.events.done.any()


@pytest.mark.parametrize("kind", ENDINGS)
def test_without_respawning_goals_and_parked_cars_stay(kind):
    _, before, after, _ = ending(kind, respawn=False)
    assert same((before.goal, before.parked_cars), (after.goal, after.parked_cars))
    np.testing.assert_array_equal(after.active, [True, False, True])
    assert after.motion.finite[::2].all()

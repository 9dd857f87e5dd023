"""Goals as poses: their reward on arrays, and what may be relabelled."""

import dataclasses
import functools
import math

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import REWARDS
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.tasks.goal_pose import POSE, pose_norm
from carpark_mj.wrappers.goal import GoalParking, goal_config

GOAL = "carpark_mj/ParkGoal-v0"
OPTIONS = {"physics": "bicycle", "parked_cars": 2}
ONE = goal_config(OPTIONS)


@functools.cache
def compiled(config=ONE):
    env = GoalParking(config)
    return env, jax.jit(env.reset), jax.jit(env.step)


def moved(env, state, pose):
    physics = env.physics.init(jnp.asarray([pose], jnp.float32), state.physics.vehicle)
    return state.replace(physics=physics, motion=env.physics.read(physics))


def test_the_reward_is_the_weighted_norm_of_highway_env():
    # Worked by hand: 0.64 m along x is 0.0064, whose root is 0.08; 1 rad askew besides
    # adds 0.02 (1 - cos 1 + sin 1).
    at = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    off = np.array([0.0064, 0.0, 3.0, 3.0, 1.0, 0.0])
    askew = np.array([0.0064, 0.0, 0.0, 0.0, math.cos(1), math.sin(1)])
    turned = math.sqrt(0.0064 + 0.02 * (1 - math.cos(1) + math.sin(1)))
    found = pose_norm(np.stack([at, off, askew]), at, **POSE.parameters)
    np.testing.assert_allclose(found, [0.0, 0.08, turned], rtol=1e-5)


def test_compute_reward_matches_steps_one_and_all():
    env = gymnasium.make_vec(GOAL, 16, **OPTIONS)
    single = gymnasium.make(GOAL, **OPTIONS).unwrapped
    env.reset(seed=0)
    actions = np.tile(np.array([0.0, 1.0], np.float32), (16, 1))
    crashes = 0
    for _ in range(60):
        observation, reward, terminated, truncated, infos = env.step(actions)
        done, final = terminated | truncated, infos.get("final_info", infos)
        crashed = np.where(done, final["crashed"], infos["crashed"])
        seen = [
            infos["final_obs"][i]
            if done[i]
            else {k: v[i] for k, v in observation.items()}
            for i in range(16)
        ]
        achieved, desired = (
            np.stack([each[name] for each in seen])
            for name in ("achieved_goal", "desired_goal")
        )
        rows = [{"crashed": value} for value in crashed]
        paid = single.compute_reward(achieved, desired, rows)
        np.testing.assert_allclose(paid, reward, atol=1e-5)
        first = single.compute_reward(achieved[0], desired[0], rows[0])
        assert first == pytest.approx(reward[0], abs=1e-5)
        relabelled = single.compute_reward(achieved, achieved, [{}])
        np.testing.assert_array_equal(relabelled, 0.0)
        crashes += crashed.sum()
    assert crashes > 0
    # One pays exactly that, as checkers of other libraries ask.
    single.reset(seed=0)
    for action in actions:
        seen, reward, *_, info = single.step(action)
        goals = seen["achieved_goal"], seen["desired_goal"]
        assert reward == single.compute_reward(*goals, info)


def test_the_goal_is_seen_in_the_desired_goal_alone():
    """Of everything that can be observed."""
    observation = ContinuousObservation(
        lines=True, route=True, global_information=True, own_car=True
    )
    config = dataclasses.replace(ONE, layout="lot", observation=observation)
    observed = {field.name for field in make_fields(config)}
    assert observed >= {"line_room", "route_next", "goal_claim"}
    goal, reset, step = compiled(config)
    state, vector = reset(jax.random.key(0))
    other = dataclasses.replace(state, goal=(state.goal + 7) % 36)
    act = jnp.zeros((1, 2))
    one, two = (goal.unpack(step(s, act)[1].observation) for s in (state, other))
    np.testing.assert_array_equal(one["observation"], two["observation"])
    np.testing.assert_array_equal(one["achieved_goal"], two["achieved_goal"])
    assert not np.allclose(one["desired_goal"], two["desired_goal"])
    assert vector.shape == (1, goal.observation_size)


def test_a_car_nose_in_in_the_middle_of_its_goal_has_reached_it():
    goal, reset, step = compiled()
    state, _ = reset(jax.random.key(0))
    bay = np.asarray(state.layout.bay_pose[state.goal[0]])
    nose_in = bay + np.array([0.0, 0.0, math.pi])
    after, timestep = step(moved(goal, state, nose_in), jnp.zeros((1, 2)))
    seen = goal.unpack(timestep.observation)
    np.testing.assert_allclose(seen["achieved_goal"], seen["desired_goal"], atol=1e-3)
    assert timestep.terminated.all()
    assert timestep.reward[0] == pytest.approx(0.0, abs=0.03)
    assert not after.active.any()
    # Backed in it is parked, though not in the goal pose.
    _, timestep = step(moved(goal, state, bay), jnp.zeros((1, 2)))
    assert timestep.terminated.all()
    assert timestep.reward[0] == pytest.approx(-math.sqrt(0.04), abs=0.01)
    # In the middle of the lot it is neither.
    centre = [0.0, 0.0, bay[2]]
    _, timestep = step(moved(goal, state, centre), jnp.zeros((1, 2)))
    assert not timestep.terminated.any()


def test_the_weights_of_the_reward_may_be_others():
    extra = {"pose": 2.0, "pose.x": 0.5, "pose.heading": 0.1, "pose.power": 1.0}
    reward = dataclasses.replace(REWARDS["pose"], crash=3.0, extra=extra)
    env, _, step = compiled(dataclasses.replace(ONE, reward=reward))
    goals = np.zeros(6), np.array([2.0, 1.0, 9.0, 9.0, 0.5, -0.5])
    paid = -2.0 * (0.5 * 2.0 + 0.3 * 1.0 + 0.1 * 1.0)
    crashed = np.array([False, True])
    np.testing.assert_allclose(env.rewards(*goals, crashed), [paid, paid - 3.0])
    state, _ = compiled()[1](jax.random.key(0))
    _, timestep = step(state, jnp.ones((1, 2)))
    parts = env.unpack(timestep.observation)
    paid = env.rewards(parts["achieved_goal"], parts["desired_goal"], np.zeros(1))
    np.testing.assert_allclose(timestep.reward, paid, rtol=1e-6)

"""What agents see at the end of a step, before any respawn."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from helpers.scenes import fields_of
from helpers.sliding import SlidePhysics, placed

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    GoalConfig,
    RingConfig,
    SensorConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import ContinuousObservation

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


def make(config=CONFIG, respawn=True):
    """An environment on sliding cars with its compiled functions."""
    episode = dataclasses.replace(config.episode, respawn=respawn)
    env = ParkingEnv(dataclasses.replace(config, episode=episode), SlidePhysics())
    return env, jax.jit(env.reset), jax.jit(env.step)


def start(env, reset, steps=(MAX_STEPS - 1, 2, 2, 0)):
    """A lot in which agent 0 times out in the next step, 1 parks and 2 hits a wall.

    With dynamic goals only agent 0 is done.
    """
    state, _ = reset(jax.random.key(4))  # agent 0 tracks a free bay
    pose = np.array([[-6.0, 0, 0], [0, 0, 0], [0, 6, 0], [6.0, 3.0, 1.0]], np.float32)
    if not env.config.goals.dynamic:
        pose[1] = state.layout.bay_pose[state.goal[1]]
        pose[2, :2] = state.layout.wall_pose[4, :2]
    state = placed(env, state, pose)
    return state.replace(step=jnp.array(steps, jnp.int32))


ACTION = np.float32([[0.3, 0.5], [0.0, 0.0], [0.0, 0.0], [-0.2, 0.4]])


def test_final_observation_is_that_without_respawn():
    env, reset, step = make()
    _, _, stay = make(respawn=False)
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


CHOOSING = dataclasses.replace(CONFIG, goals=GoalConfig(dynamic=True))


def test_final_observation_ignores_the_time_limit():
    """The goal chosen in the step, and the bays tracked from where the car stands."""
    choice = 1
    env, reset, step = make(CHOOSING)
    state = start(env, reset)
    action = np.concatenate([ACTION, np.full((4, 1), choice, np.float32)], axis=1)
    _, timestep = step(state, action)
    _, expected = step(state.replace(step=jnp.zeros(4, jnp.int32)), action)
    assert timestep.events.timed_out[0]
    assert not expected.events.done.any()
    final = timestep.final_observation
    np.testing.assert_array_equal(final[0], expected.observation[0])
    assert (np.asarray(final[0]) != np.asarray(timestep.observation[0])).any()
    named = fields_of(final, env.config)
    assert named["goal_position"][0].any()

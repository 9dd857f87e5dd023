"""Goals that follow from starts, and MetaDrive's rule of arrival."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import boxes_overlap
from carpark_mj.layouts import make_layout
from carpark_mj.spawning.goals import goal_of_start
from carpark_mj.spawning.placing import start_placing
from carpark_mj.suite.metadrive import METADRIVE
from carpark_mj.types import NO_BAY

SPACES, EXITS = range(8), range(8, 11)
SHORT = dataclasses.replace(METADRIVE.episode, max_steps=2)


def test_cars_in_bays_drive_out_and_others_to_bays_that_nobody_drives_to():
    layout = make_layout("metadrive")
    # Agents 1 and 2 drive to spaces, 3 to an exit; 4 waits, its goal is free again.
    goal = jnp.array([5, 0, 1, 8, 2])
    waiting = jnp.array([False, False, False, False, True])
    nobody = jnp.full(0, NO_BAY)

    def goals(pose):
        placing = start_placing(goal, nobody, jnp.tile(pose, (5, 1)), waiting)
        scores = jax.random.uniform(jax.random.key(0), (500, 11))
        draw = jax.vmap(lambda s: goal_of_start(layout, placing, jnp.int32(0), s))
        return np.bincount(np.asarray(draw(scores)), minlength=11)

    out = goals(layout.bay_pose[6])
    assert not out[:8].any()
    assert out[8:].min() > 500 / 3 * 0.8  # an exit may be the goal of several
    into = goals(layout.spawn_pose[1])
    assert into[[0, 1, 8, 9, 10]].tolist() == [0] * 5
    assert into[2:8].min() > 500 / 6 * 0.6


def test_cars_leave_again_where_every_bay_is_another_agents_goal():
    layout = make_layout("metadrive")
    goal = jnp.arange(9).at[8].set(NO_BAY)
    placing = start_placing(
        goal,
        jnp.full(0, NO_BAY),
        jnp.tile(layout.spawn_pose[1], (9, 1)),
        jnp.arange(9) == 8,
    )
    scores = jax.random.uniform(jax.random.key(0), (100, 11))
    drawn = jax.vmap(lambda s: goal_of_start(layout, placing, jnp.int32(8), s))(scores)
    assert set(drawn.tolist()) == set(EXITS)


def test_absent_agents_keep_no_bay_or_exit_from_others():
    config = dataclasses.replace(METADRIVE, episode=SHORT, min_agents=1)
    env = ParkingEnv(config)
    reset = jax.jit(jax.vmap(lambda key: env.reset(key, num_present=3)))
    state, _ = reset(jax.random.split(jax.random.key(0), 20))
    goal = np.asarray(state.goal)
    assert (goal[:, :3] != NO_BAY).all()
    assert (goal[:, 3:] == NO_BAY).all()


def test_lots_begin_with_cars_at_eleven_places_and_respawn_in_them():
    env = ParkingEnv(dataclasses.replace(METADRIVE, episode=SHORT))
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(1), 20))
    _check(state)
    step, rest = jax.jit(jax.vmap(env.step)), jnp.zeros((20, 10, 2))
    # In the second step all time out, and start anew.
    state, timestep = step(step(state, rest)[0], rest)
    assert timestep.events.timed_out.all()
    _check(state)


def _check(state):
    xy, goal = np.asarray(state.motion.pose_w[..., :2]), np.asarray(state.goal)
    place = np.asarray(state.layout.spawn_pose[:, None, :, :2])
    gap = np.abs(xy[:, :, None] - place).max(axis=-1)
    assert (gap.min(axis=-1) <= 1.01).all()
    in_bay = gap.argmin(axis=-1) >= 3
    np.testing.assert_array_equal(in_bay, goal >= 8)
    for goals in goal:
        spaces = goals[goals < 8]
        assert len(set(spaces.tolist())) == len(spaces)
    pose, size = state.motion.pose_w, state.motion.size
    meet = boxes_overlap(
        pose[:, :, None], size[:, :, None], pose[:, None], size[:, None]
    )
    assert meet.sum() == meet.shape[0] * meet.shape[1]  # each with itself only

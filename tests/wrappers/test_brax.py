"""Lots as one Brax environment."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from helpers.sliding import APART, MAX_STEPS, placed, slide

from carpark_mj.env import ParkingEnv
from carpark_mj.wrappers.brax import BraxParking


@functools.cache
def brax():
    """The wrapper on sliding cars, 4 lots, with its compiled functions."""
    wrapped = BraxParking(slide()[0])
    return wrapped, jax.jit(wrapped.reset), jax.jit(wrapped.step)


def test_brax_flattens_lots_by_agents():
    env, reset, step = slide()
    _, brax_reset, brax_step = brax()
    keys = jax.random.split(jax.random.key(0), 4)
    state = brax_reset(keys)
    assert state.obs.shape == (12, env.observation_size)
    # The action of one agent of one lot moves that car and no other.
    action = np.zeros((12, 2), np.float32)
    action[3 * 2 + 1] = (0.0, 1.0)
    after = brax_step(state, action)
    moved = np.asarray(after.pipeline_state.motion.speed)
    np.testing.assert_array_equal(np.argwhere(moved != 0.0), [[2, 1]])
    # Rows 3 k to 3 k + 2 are those of lot k on its own.
    for k in range(4):
        rows = slice(3 * k, 3 * k + 3)
        lot, observation = reset(keys[k])
        # Single and batched programs may round differently.
        np.testing.assert_allclose(state.obs[rows], observation, atol=1e-5)
        _, timestep = step(lot, action[rows])
        np.testing.assert_allclose(after.obs[rows], timestep.observation, atol=1e-5)
        np.testing.assert_allclose(after.reward[rows], timestep.reward, atol=1e-5)


def test_brax_steps_keep_the_structure_of_the_reset_state():
    env, _, _ = slide()
    wrapped = BraxParking(env)
    state = jax.eval_shape(wrapped.reset, jax.random.split(jax.random.key(0), 4))
    action = jax.ShapeDtypeStruct((12, 2), jnp.float32)
    after = jax.eval_shape(wrapped.step, state, action)

    def kinds(tree):
        return jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), tree)

    assert kinds(state) == kinds(after)
    flat = (state.obs, state.reward, state.done, state.info)
    assert all(leaf.shape[0] == 12 for leaf in jax.tree.leaves(flat))
    fields = {"truncation", "present", "episode_done", "episode_metrics"}
    assert set(state.info) == fields | {"reward_terms", "final_observation"}
    assert wrapped.observation_size == env.observation_size
    assert wrapped.action_size == 2


def test_brax_passes_final_observations_on():
    plain, _, _ = slide()
    episode = dataclasses.replace(plain.config.episode, final_observation=True)
    config = dataclasses.replace(plain.config, episode=episode)
    env = ParkingEnv(config, plain.physics)
    wrapped = BraxParking(env)
    keys = jax.random.split(jax.random.key(0), 4)
    own = jax.eval_shape(wrapped.reset, keys)
    state = brax()[1](keys)  # begins alike
    lots = state.pipeline_state
    lots = lots.replace(step=lots.step.at[1, 2].set(MAX_STEPS - 1))
    state = state.replace(pipeline_state=lots)
    after = jax.jit(wrapped.step)(state, np.zeros((12, 2), np.float32))
    assert jax.tree.structure(own) == jax.tree.structure(after)
    _, timestep = jax.jit(jax.vmap(env.step))(lots, np.zeros((4, 3, 2), np.float32))
    final = after.info["final_observation"]
    np.testing.assert_allclose(final[5], timestep.final_observation[1, 2], atol=1e-5)
    assert not np.allclose(final[5], after.obs[5])  # that is of the next episode


def test_brax_tells_truncations_from_terminations():
    env, _, _ = slide()
    _, reset, step = brax()
    state = reset(jax.random.split(jax.random.key(0), 4))
    lots = placed(env, state.pipeline_state, np.tile(APART, (4, 1, 1)))
    # Lot 1: agent 0 in a wall. Lot 2: agent 1 out of time.
    pose = np.array(lots.motion.pose_w)
    pose[1, 0, :2] = lots.layout.wall_pose[1, 4, :2]
    lots = placed(env, lots, pose)
    lots = lots.replace(step=lots.step.at[2, 1].set(MAX_STEPS - 1))
    state = step(state.replace(pipeline_state=lots), np.zeros((12, 2), np.float32))
    assert np.flatnonzero(state.done).tolist() == [3, 7]
    assert np.flatnonzero(state.info["episode_done"]).tolist() == [3, 7]
    assert np.flatnonzero(state.info["truncation"]).tolist() == [7]
    assert np.flatnonzero(state.info["episode_metrics"]["crashed"]).tolist() == [3]
    assert np.flatnonzero(state.info["episode_metrics"]["timed_out"]).tolist() == [7]
    assert all(leaf.shape == (12,) for leaf in jax.tree.leaves(state.info))

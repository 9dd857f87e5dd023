"""Lots as a batch of arrays or torch tensors, and as one Brax environment."""

import copy
import dataclasses
import functools
import pickle

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import APART, MAX_STEPS, placed, slide
from helpers.trees import same

import carpark_mj
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.physics.scene import ScenePhysics
from carpark_mj.registration import ENTRY_POINTS
from carpark_mj.wrappers.batch import NumpyBatch
from carpark_mj.wrappers.brax import BraxParking

LOTS = 50  # several groups of those that begin anew together, of two lots


def batch(num_lots=4, respawn=False, restart=True):
    return NumpyBatch(slide(respawn=respawn)[0], num_lots, restart)


def halt(num_lots=4):
    return np.zeros((num_lots, 3, 2), np.float32)


def key_data(state):
    return np.asarray(jax.random.key_data(state.key))


def test_a_lot_of_a_batch_is_the_lot_of_its_seed_on_its_own():
    _, reset, step = slide(respawn=False)
    lots = batch()
    observation = lots.reset_numpy(7)
    action = np.random.default_rng(0).uniform(-1, 1, (4, 3, 2)).astype(np.float32)
    after = lots.step_numpy(action)
    for k in range(4):
        state, alone = reset(jax.random.key(7 + k))
        # Single and batched programs may round differently.
        np.testing.assert_allclose(observation[k], alone, atol=1e-5)
        _, timestep = step(state, action[k])
        np.testing.assert_allclose(
            after.observation[k], timestep.observation, atol=1e-5
        )
        np.testing.assert_allclose(after.reward[k], timestep.reward, atol=1e-5)


def test_a_sequence_of_seeds_gives_each_lot_its_own():
    lots = batch()
    in_turn = lots.reset_numpy([9, 3, 9, 4])
    np.testing.assert_array_equal(in_turn[0], in_turn[2])
    np.testing.assert_array_equal(in_turn[[1, 3]], lots.reset_numpy(3)[:2])
    # Seeds that are None are drawn.
    one, two = (batch().reset_numpy([1, None, 3, None]) for _ in range(2))
    np.testing.assert_array_equal(one[::2], two[::2])
    assert (one[1::2] != two[1::2]).any(axis=(1, 2)).all()


def test_without_a_seed_lots_go_on_and_do_not_repeat():
    lots = batch()
    first = lots.reset_numpy(0)
    second, third = lots.reset_numpy(), lots.reset_numpy()
    assert not np.array_equal(first, second)
    assert not np.array_equal(second, third)
    lots.reset_numpy(0)
    np.testing.assert_array_equal(second, lots.reset_numpy())
    assert not np.array_equal(batch().reset_numpy(), batch().reset_numpy())


@pytest.mark.parametrize("num_lots", [4, LOTS])
def test_lots_restart_when_all_agents_have_finished(num_lots):
    lots, waiting = batch(num_lots), batch(num_lots, restart=False)
    first = lots.reset_numpy(0)
    np.testing.assert_array_equal(waiting.reset_numpy(0), first)
    for _ in range(MAX_STEPS):
        assert lots.state.step.min() < MAX_STEPS
        step, alone = (each.step_numpy(halt(num_lots)) for each in (lots, waiting))
    assert step.truncated.all()
    np.testing.assert_array_equal(step.final_observation, alone.observation)
    assert not np.isclose(step.observation, first).all(axis=(1, 2)).any()
    assert lots.state.active.all()
    assert not lots.state.step.any()
    # What begins is what `reset` would have begun.
    np.testing.assert_allclose(step.observation, waiting.reset_numpy(), atol=1e-6)


def test_lot_waits_for_its_last_agent():
    lots, waiting = batch(), batch(restart=False)
    pose = np.tile(APART, (4, 1, 1))
    pose[1] = APART[0]  # in lot 1 all agents collide, in lot 2 two of the three
    pose[2, :2] = APART[0]
    for each in (lots, waiting):
        each.reset_numpy(0)
        state = placed(each.env, each.state, pose)
        each._state = jax.tree.map(jnp.copy, state)  # no buffer twice
    before = key_data(lots.state)
    step, alone = lots.step_numpy(halt()), waiting.step_numpy(halt())
    anew = np.array([False, True, False, False])
    np.testing.assert_array_equal(step.crashed.all(axis=1), anew)
    assert step.crashed[2].tolist() == [True, True, False]
    np.testing.assert_array_equal(lots.state.active.all(axis=1), [1, 1, 0, 1])
    np.testing.assert_array_equal(step.final_observation, alone.observation)
    np.testing.assert_array_equal(step.observation[~anew], alone.observation[~anew])
    assert not np.isclose(step.observation[1], alone.observation[1]).all()
    assert (key_data(lots.state) != before).any(axis=1)[1]


def test_arrays_are_the_callers_own():
    lots = batch()
    kept = [lots.reset_numpy(0), *lots.step_numpy(halt())]
    copies = [array.copy() for array in kept]
    for _ in range(MAX_STEPS):
        lots.step_numpy(halt())
    for array, twin in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(array, twin)
        array[...] = 0  # not read-only


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (halt(3), r"shape \(4, 3, 2\), not \(3, 3, 2\)"),
        (halt() * np.nan, "finite numbers, not nan .lot 0, agent 0"),
        (halt() * 1j, "real numbers, not complex"),
        (None, "real numbers, not object"),
    ],
)
def test_impossible_actions_are_refused(action, message):
    lots = batch()
    lots.reset_numpy(0)
    with pytest.raises(ValueError, match=message):
        lots.step_numpy(action)
    lots.step_numpy(halt())  # and nothing is broken


PARK, GOAL, *_ = ENTRY_POINTS
QUICK = EnvConfig(layout="square_compact", num_parked_cars=2, physics="bicycle")
AHEAD = np.array([0.2, 1.0], np.float32)


def pickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize(("copied", "name"), [(copy.deepcopy, GOAL), (pickled, PARK)])
def test_a_copy_goes_on_like_the_environment(copied, name):
    env = gymnasium.make(name, config=QUICK, render_mode="rgb_array")
    assert copied(env).reset(seed=1)[0] is not None  # before the first reset
    env.reset(seed=0)
    picture = env.render()
    other = copied(env)
    np.testing.assert_array_equal(other.render(), picture)
    for _ in range(3):
        assert same(env.step(AHEAD)[0], other.step(AHEAD)[0])
    other.step(AHEAD)  # on its own
    np.testing.assert_array_equal(env.unwrapped._batch.state.step, [[3]])
    env.close()
    other.close()


def test_so_does_a_copy_of_a_lot_of_agents():
    pytest.importorskip("pettingzoo")
    env = carpark_mj.parallel_env(config=QUICK, agents=2, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().std() > 10
    actions, other = dict.fromkeys(env.agents, AHEAD), pickled(env)
    assert same(other.step(actions)[0], env.step(actions)[0])


def test_a_scene_is_pickled_too():
    config = EnvConfig(num_agents=1, num_parked_cars=0, physics="scene")
    physics = pickled(ParkingEnv(config)).physics
    assert isinstance(physics, ScenePhysics)
    assert physics.scene.model.nq > 0


def tensors():
    pytest.importorskip("torch", reason='pip install -e ".[sb3]"')
    from carpark_mj.wrappers.torch_batch import TorchBatch

    return TorchBatch(slide(respawn=False)[0], 4)


def test_tensors_hold_the_numbers_of_the_numpy_batch():
    """Whether actions are strided or require gradients."""
    torch = pytest.importorskip("torch")
    lots, reference = tensors(), batch()
    np.testing.assert_array_equal(lots.reset(3), reference.reset_numpy(3))
    for seed in range(MAX_STEPS + 2):
        action = np.random.default_rng(seed).uniform(-1, 1, (4, 3, 2))
        twice = torch.as_tensor(action.repeat(2, axis=2), dtype=torch.float32)
        strided = twice[..., ::2].requires_grad_()
        assert not strided.is_contiguous()
        step = lots.step(strided)
        expected = reference.step_numpy(action)
        strided.detach().zero_()
        for name, tensor in step._asdict().items():
            np.testing.assert_array_equal(tensor, getattr(expected, name), name)
    assert step.terminated.dtype == torch.bool
    assert step.observation.dtype == torch.float32
    assert not step.observation.requires_grad


def test_tensors_share_memory_and_stay_as_they_are():
    torch, lots = pytest.importorskip("torch"), tensors()
    lots.reset(0)
    seen = []
    step_jax, shown = lots.batch.step, []
    lots.batch.step = lambda action: shown.append(step_jax(action)) or shown[-1]
    for _ in range(2 * MAX_STEPS):
        step = lots.step(torch.rand(4, 3, 2))
        seen.append((step, [tensor.clone() for tensor in step]))
        pointer = shown[-1].observation.unsafe_buffer_pointer()
        assert step.observation.data_ptr() == pointer
        assert step.reward.data_ptr() == shown[-1].reward.unsafe_buffer_pointer()
    shown.clear()
    for step, clones in seen:
        for tensor, clone in zip(step, clones, strict=True):
            assert torch.equal(tensor, clone)


# Brax


@functools.cache
def brax():
    """The wrapper on sliding cars, with final observations, and compiled functions."""
    plain, _, _ = slide()
    episode = dataclasses.replace(plain.config.episode, final_observation=True)
    config = dataclasses.replace(plain.config, episode=episode)
    wrapped = BraxParking(ParkingEnv(config, plain.physics))
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
    wrapped, _, _ = brax()
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


def test_brax_tells_how_episodes_end_and_what_was_seen_last():
    env, _, _ = slide()
    _, reset, step = brax()
    state = reset(jax.random.split(jax.random.key(0), 4))
    lots = placed(env, state.pipeline_state, np.tile(APART, (4, 1, 1)))
    halted = np.zeros((12, 2), np.float32)
    seen = step(state.replace(pipeline_state=lots), halted).obs
    # Lot 1: agent 0 in a wall. Lot 2: agent 1 out of time.
    pose = np.array(lots.motion.pose_w)
    pose[1, 0, :2] = lots.layout.wall_pose[1, 4, :2]
    lots = placed(env, lots, pose)
    lots = lots.replace(step=lots.step.at[2, 1].set(MAX_STEPS - 1))
    state = step(state.replace(pipeline_state=lots), halted)
    assert np.flatnonzero(state.done).tolist() == [3, 7]
    assert np.flatnonzero(state.info["episode_done"]).tolist() == [3, 7]
    assert np.flatnonzero(state.info["truncation"]).tolist() == [7]
    assert np.flatnonzero(state.info["episode_metrics"]["crashed"]).tolist() == [3]
    assert np.flatnonzero(state.info["episode_metrics"]["timed_out"]).tolist() == [7]
    final = state.info["final_observation"]
    np.testing.assert_allclose(final[7], seen[7], atol=1e-5)
    assert not np.allclose(final[7], state.obs[7])  # that is of the next episode

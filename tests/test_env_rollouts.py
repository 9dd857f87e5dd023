"""The environment with the real car: a random rollout, batches and broken numbers.

All share one compiled environment (`scenes.mjx_*`).
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.scenes import (
    LOTS,
    check_occupancy,
    fields_of,
    mixed_lots,
    mjx_env,
    mjx_rollout,
    mjx_start,
    mjx_step,
    stacked,
)
from helpers.sliding import slide
from helpers.trees import leaves, same

from carpark_mj.observations.fields import FAR


@pytest.fixture(scope="module")
def rollout():
    """States and time steps of 300 random steps, with a leading time axis."""
    _, _, states, timesteps = mjx_rollout()
    return stacked(states), stacked(timesteps)


def test_a_random_rollout_stays_finite(rollout):
    floats = [x for x in jax.tree.leaves(rollout) if x.dtype.kind == "f"]
    assert len(floats) > 50
    assert all(np.isfinite(x).all() for x in floats)
    _, timesteps = rollout
    assert not timesteps.events.diverged.any()
    # It is a rollout worth looking at.
    assert timesteps.events.crashed.sum() > 20
    assert timesteps.events.timed_out.sum() > 20
    assert timesteps.events.hit_wall.any()
    assert timesteps.events.hit_parked_car.any()
    assert timesteps.events.hit_agent.any()


def test_occupancy_invariants_hold_throughout_a_rollout(rollout):
    states, _ = rollout
    mask = states.layout.bay_mask
    check_occupancy(states.goal, states.parked_cars.bay, mask)


def test_step_counters_count_and_start_again_at_every_end(rollout):
    states, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    before = np.concatenate([np.zeros_like(states.step[:1]), states.step[:-1]])
    np.testing.assert_array_equal(states.step, np.where(done, 0, before + 1))
    assert states.step.max() == mjx_env().config.episode.max_steps - 1


def test_episode_metrics_are_the_sums_over_the_episode(rollout):
    _, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    steps = {"episode_return": timesteps.reward, "length": np.ones(done.shape)}
    terms = timesteps.reward_terms
    steps |= {f"return_{name}": term for name, term in terms.items()}
    for name, numbers in steps.items():
        total, expected = np.zeros(done.shape[1:]), np.zeros(done.shape)
        for k in range(done.shape[0]):
            expected[k] = total = total + numbers[k]
            total = np.where(done[k], 0, total)
        got = timesteps.metrics[name][done]
        # float32 sums of 60 numbers up to 4.
        np.testing.assert_allclose(got, expected[done], atol=1e-4, err_msg=name)


def test_rewards_are_the_sums_of_their_terms_in_a_rollout(rollout):
    _, timesteps = rollout
    total = np.sum(list(timesteps.reward_terms.values()), axis=0)
    np.testing.assert_allclose(timesteps.reward, total, atol=1e-6)  # float32


def test_agents_that_respawn_stand_still_in_the_spawn_region(rollout):
    states, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    half = states.layout.spawn_size[:, :, :1, :] / 2
    # 1e-4: from the centre to the rear axle and back, in float32.
    inside = (np.abs(states.motion.pose_w[..., :2]) <= half + 1e-4).all(axis=-1)
    assert inside[done].all()
    np.testing.assert_array_equal(states.motion.velocity_b[done], 0.0)
    named = fields_of(timesteps.observation, mjx_env().config)
    for name in ("speed", "steering", "yaw_rate"):
        np.testing.assert_array_equal(named[name][done], 0.0)
    goal = np.take_along_axis(states.layout.bay_pose, states.goal[..., None], axis=2)
    distance = np.linalg.norm((states.motion.pose_w - goal)[..., :2], axis=-1)
    np.testing.assert_allclose(
        named["goal_distance"][..., 0] * FAR, distance, atol=1e-4
    )


def test_each_lot_of_a_batch_keeps_its_own_layout(rollout):
    states, timesteps = rollout
    layouts = jax.device_get(mixed_lots())
    for mine, given in zip(
        jax.tree.leaves(states.layout), jax.tree.leaves(layouts), strict=True
    ):
        np.testing.assert_array_equal(mine, np.broadcast_to(given, mine.shape))
    # Cars of the compact lots (odd) end within their smaller walls.
    reach = np.abs(timesteps.motion.pose_w[..., :2]).max(axis=(0, 2, 3))
    assert (reach[1::2] < layouts.extent[1, 0]).all()
    assert (reach[::2] < layouts.extent[0, 0]).all()
    spawned = np.abs(states.motion.pose_w[0, ..., :2]).max(axis=(1, 2))
    assert spawned.shape == (LOTS,)


def test_stepping_again_does_not_compile_again():
    state, _ = mjx_start(5)
    mjx_step().clear_cache()  # other files have their programs in it
    for _ in range(2):
        state, _ = mjx_step()(state, jnp.zeros((LOTS, 3, 2)))
    assert mjx_step()._cache_size() == 1


def test_states_and_time_steps_hold_no_weak_types():
    env, _, _ = slide()
    for environment in (env, mjx_env()):
        state, observation = jax.eval_shape(environment.reset, jax.random.key(0))
        count = environment.num_agents
        action = jax.ShapeDtypeStruct((count, 2), jnp.float32)
        later, timestep = jax.eval_shape(environment.step, state, action)
        weak = [
            jax.tree_util.keystr(path)
            for path, leaf in jax.tree_util.tree_leaves_with_path(
                (state, observation, later, timestep)
            )
            if leaf.weak_type
        ]
        assert weak == []

        def kinds(tree):
            return [(x.shape, x.dtype) for x in jax.tree.leaves(tree)]

        assert kinds(state) == kinds(later)


def stepped_pair(change):
    """One step from the same state, as it is and with something changed."""
    state, _ = mjx_start(2)
    action = jnp.asarray(
        np.random.default_rng(2).uniform(-1, 1, (LOTS, 3, 2)), jnp.float32
    )
    for _ in range(5):
        state, _ = mjx_step()(state, action)
    return (
        jax.device_get(mjx_step()(state, action)[1]),
        state,
        mjx_step()(state, action)[0],
        *mjx_step()(change(state), action),
    )


def unaffected(plain, changed, lot=1, agent=0):
    """Whether the physics of all cars but one agree bit for bit."""
    others = np.ones((LOTS, 3), bool)
    others[lot, agent] = False
    return same(
        jax.tree.map(lambda x: x[others], plain.physics),
        jax.tree.map(lambda x: x[others], changed.physics),
    )


def test_the_others_drive_on_bit_for_bit_when_an_agent_respawns():
    def almost_over(state):
        last = mjx_env().config.episode.max_steps - 1
        return state.replace(step=state.step.at[1, 0].set(last))

    plain_step, _, plain, changed, timestep = stepped_pair(almost_over)
    assert not plain_step.events.done.any()
    expected = np.zeros((LOTS, 3), bool)
    expected[1, 0] = True
    np.testing.assert_array_equal(timestep.events.done, expected)
    assert unaffected(plain, changed)
    assert not np.array_equal(plain.motion.pose_w[1, 0], changed.motion.pose_w[1, 0])
    np.testing.assert_array_equal(timestep.reward, plain_step.reward)


def test_a_car_that_turns_nan_is_put_out_and_nobody_else_notices():
    def poisoned(state):
        qvel = state.physics.qvel.at[1, 0, 3].set(jnp.nan)
        return state.replace(physics=state.physics.replace(qvel=qvel))

    plain_step, before, plain, after, timestep = stepped_pair(poisoned)
    expected = np.zeros((LOTS, 3), bool)
    expected[1, 0] = True
    np.testing.assert_array_equal(timestep.events.diverged, expected)
    np.testing.assert_array_equal(timestep.events.done, expected)
    np.testing.assert_array_equal(timestep.truncated, expected)
    assert not timestep.terminated.any()
    np.testing.assert_array_equal(timestep.metrics["diverged"], expected)
    assert float(timestep.reward[1, 0]) == 0.0
    assert all(float(term[1, 0]) == 0.0 for term in timestep.reward_terms.values())
    np.testing.assert_array_equal(
        np.asarray(timestep.reward)[~expected], plain_step.reward[~expected]
    )
    # Back at its last finite pose for the metrics, then in a new episode.
    np.testing.assert_allclose(
        timestep.motion.pose_w[1, 0], before.motion.pose_w[1, 0], atol=1e-6
    )
    assert int(after.step[1, 0]) == 0
    assert after.motion.finite.all()
    floats = [
        x for x in leaves((after, timestep)) if np.issubdtype(x.dtype, np.floating)
    ]
    assert all(np.isfinite(x).all() for x in floats)
    assert unaffected(plain, after)
    later, _ = mjx_step()(after, jnp.zeros((LOTS, 3, 2)))
    assert later.motion.finite.all()

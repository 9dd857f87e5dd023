"""The environment's contract, one test per sentence.

Hand-worked steps use `scenes.SlidePhysics`; what needs the real car shares one
compiled environment and one random rollout (`scenes.mjx_*`).
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
from helpers.sliding import APART, HALT, MAX_STEPS, in_goal, placed, slide, start

from carpark_mj.config import reward_preset
from carpark_mj.observations.fields import FAR


def leaves(tree):
    """The leaves as numpy arrays, keys as their numbers."""
    return [
        np.asarray(
            jax.random.key_data(x)
            if jnp.issubdtype(x.dtype, jax.dtypes.prng_key)
            else x
        )
        for x in jax.tree.leaves(tree)
    ]


def same(a, b):
    """Whether two trees agree bit for bit, NaN included."""
    pairs = list(zip(leaves(a), leaves(b), strict=True))
    assert pairs
    return all(np.array_equal(x, y, equal_nan=x.dtype.kind == "f") for x, y in pairs)


def agent_of(tree, agent):
    """One agent's part of a tree whose leaves lead with (agents,)."""
    return jax.tree.map(lambda x: x[agent], tree)


# Reset


def test_reset_is_a_function_of_the_key():
    _, reset, _ = slide()
    assert same(reset(jax.random.key(3)), reset(jax.random.key(3)))
    one, other = reset(jax.random.key(3))[0], reset(jax.random.key(4))[0]
    assert not same(one.goal, other.goal)
    assert not same(one.motion.pose_w, other.motion.pose_w)
    assert not same(one.key, other.key)


def test_reset_starts_every_episode_at_zero():
    env, reset, _ = slide()
    state, observation = reset(jax.random.key(0))
    assert observation.shape == (3, env.observation_size)
    np.testing.assert_array_equal(state.step, [0, 0, 0])
    assert state.active.all()
    assert not np.any(jax.tree.leaves(state.stats))
    mask = np.asarray(state.layout.bay_mask)
    check_occupancy(state.goal, state.parked_cars.bay, mask)


def test_agents_start_apart_from_each_other():
    env, _, _ = slide()
    keys = jax.random.split(jax.random.key(1), 200)
    pose = np.asarray(jax.jit(jax.vmap(env.reset))(keys)[0].motion.pose_w)
    gap = np.linalg.norm(pose[:, :, None, :2] - pose[:, None, :, :2], axis=-1)
    gap = gap[:, ~np.eye(3, dtype=bool)].min(axis=1)
    # Three of 7.38 m fit well but a close spawn may find no room: never on top.
    assert (gap > env.config.spawn.min_distance).mean() > 0.9
    assert gap.min() > 3.0


# Step


def test_step_is_pure():
    env, step, state = start()
    before, constants = leaves(state), dict(vars(env))
    action = np.float32([[0.5, 1.0], [0.0, -1.0], [-1.0, 0.3]])
    first, second = step(state, action), step(state, action)
    assert same(first, second)
    assert all(map(np.array_equal, before, leaves(state)))
    assert vars(env) == constants


def test_an_agent_that_drives_on_gets_neither_terminated_nor_truncated():
    _, step, state = start()
    state, timestep = step(state, HALT + 0.5)
    assert not (timestep.terminated | timestep.truncated).any()
    np.testing.assert_array_equal(state.step, [1, 1, 1])
    np.testing.assert_array_equal(state.stats.length, [1, 1, 1])


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


ENDINGS = ("parked", "crashed", "timed_out", "diverged")


@pytest.mark.parametrize("kind", ENDINGS)
def test_parking_and_crashing_terminate_and_the_other_endings_truncate(kind):
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


def test_a_parked_car_moves_into_the_bay_where_an_agent_has_parked():
    _, before, after, _ = ending("parked")
    assert before.goal[1] in after.parked_cars.bay
    assert before.goal[1] not in before.parked_cars.bay


@pytest.mark.parametrize("kind", ["crashed", "timed_out", "diverged"])
def test_otherwise_a_parked_car_moves_only_off_the_new_goal(kind):
    _, before, after, _ = ending(kind)
    cars_before = np.asarray(before.parked_cars.bay)
    cars_after = np.asarray(after.parked_cars.bay)
    on_new_goal = cars_before == int(after.goal[1])
    np.testing.assert_array_equal(cars_before != cars_after, on_new_goal)


@pytest.mark.parametrize("kind", ENDINGS)
def test_the_time_step_shows_the_motion_before_the_respawn(kind):
    _, before, _, timestep = ending(kind)
    np.testing.assert_array_equal(timestep.motion.pose_w, before.motion.pose_w)
    distance = np.linalg.norm(
        before.motion.pose_w[:, :2] - before.layout.bay_pose[before.goal][:, :2],
        axis=1,
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
            after.goal,
            after.parked_cars.bay,
            np.asarray(after.layout.bay_mask),
        )
        gap = np.linalg.norm(np.diff(after.motion.pose_w[:2, :2], axis=0))
        assert gap > 3.0


def test_the_reward_is_the_sum_of_its_terms():
    for kind in ENDINGS:
        _, _, _, timestep = ending(kind)
        total = np.sum(list(timestep.reward_terms.values()), axis=0)
        np.testing.assert_allclose(timestep.reward, total, atol=1e-6)  # float32


def test_parking_pays_and_crashing_costs_what_the_config_says():
    weights = reward_preset("shaped")
    _, _, _, timestep = ending("parked")
    time = -weights.time / MAX_STEPS
    # float32 sums; standing cars make no progress.
    expected = [time, weights.park + time, time]
    np.testing.assert_allclose(timestep.reward, expected, atol=1e-5)
    _, _, _, timestep = ending("crashed")
    expected = [time, -weights.crash + time, time]
    np.testing.assert_allclose(timestep.reward, expected, atol=1e-5)


# Without respawning


def test_without_respawning_finished_agents_are_frozen_for_ever():
    # Agent 1 runs out of time at full speed and stops dead there.
    _, step, state = start(respawn=False)
    state = state.replace(step=jnp.array([0, MAX_STEPS - 1, 0], jnp.int32))
    state, timestep = step(state, np.float32([[0, 0], [0.5, 1.0], [0, 0]]))
    np.testing.assert_array_equal(timestep.events.timed_out, [False, True, False])
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


def test_an_agent_that_drives_into_a_frozen_one_crashes_alone():
    # 4.5 m apart, 4.255 m long, and 0.5 m a step.
    pose = APART.copy()
    pose[0, 0] += 0.5
    _, step, state = start(False, pose)
    state = state.replace(active=jnp.array([True, False, True]))
    state, timestep = step(state, np.float32([[0, 1], [0, 1], [0, 0]]))
    np.testing.assert_array_equal(timestep.events.crashed, [True, False, False])
    np.testing.assert_array_equal(timestep.events.hit_agent, [True, False, False])
    np.testing.assert_array_equal(state.motion.pose_w[1], APART[1])


# The real car


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


def test_terminated_and_truncated_exclude_each_other_in_a_rollout(rollout):
    _, timesteps = rollout
    events = timesteps.events
    assert not (timesteps.terminated & timesteps.truncated).any()
    np.testing.assert_array_equal(timesteps.terminated, events.parked | events.crashed)
    np.testing.assert_array_equal(
        timesteps.truncated, events.timed_out | events.diverged
    )


def test_step_counters_count_and_start_again_at_every_end(rollout):
    states, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    before = np.concatenate([np.zeros_like(states.step[:1]), states.step[:-1]])
    np.testing.assert_array_equal(states.step, np.where(done, 0, before + 1))
    assert states.step.max() == mjx_env().config.episode.max_steps - 1


def test_episode_metrics_are_the_sums_over_the_episode(rollout):
    _, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    returns, lengths = np.zeros(done.shape[1:]), np.zeros(done.shape[1:])
    expected = np.zeros((2, *done.shape))
    for k in range(done.shape[0]):
        returns, lengths = returns + timesteps.reward[k], lengths + 1
        expected[:, k] = returns, lengths
        returns, lengths = np.where(done[k], 0, [returns, lengths])
    for name, value in zip(("episode_return", "length"), expected, strict=True):
        # float32 sums of 60 numbers up to 4.
        np.testing.assert_allclose(
            timesteps.metrics[name][done], value[done], atol=1e-4, err_msg=name
        )


def test_returns_by_term_are_the_sums_over_the_episode(rollout):
    _, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    for name, term in timesteps.reward_terms.items():
        total, expected = np.zeros(done.shape[1:]), np.zeros(done.shape)
        for k in range(done.shape[0]):
            total = total + term[k]
            expected[k] = total
            total = np.where(done[k], 0, total)
        got = timesteps.metrics[f"return_{name}"]
        # float32 sums of 60 numbers up to 4.
        np.testing.assert_allclose(got[done], expected[done], atol=1e-4, err_msg=name)


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
    mjx_rollout()
    state, _ = mjx_start(5)
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
    assert not plain_step.events.done.any()
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


def test_a_car_placed_in_its_goal_parks_and_its_bay_fills():
    env = mjx_env()
    state, _ = mjx_start(3)
    pose = np.array(state.motion.pose_w)
    goal = np.asarray(state.goal[:, 0])
    pose[:, 0] = np.asarray(state.layout.bay_pose)[np.arange(LOTS), goal]
    state = placed(env, state, pose)
    after, timestep = mjx_step()(state, jnp.zeros((LOTS, 3, 2)))
    np.testing.assert_array_equal(timestep.events.parked, [[True, False, False]] * LOTS)
    assert (after.parked_cars.bay == goal[:, None]).any(axis=1).all()
    named = timestep.reward_terms["park"]
    np.testing.assert_array_equal(named[:, 0], env.config.reward.park)

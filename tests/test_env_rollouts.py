"""The environment with the real car, its arguments, states passed on, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import pytest
from helpers.programs import ROOT, python
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
from helpers.sliding import HALT, slide
from helpers.trees import leaves, same

from carpark_mj.config import EnvConfig, RewardConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp import rewards
from carpark_mj.observations.fields import FAR
from carpark_mj.types import with_empty, without_empty


@pytest.fixture(scope="module")
def rollout():
    """States and time steps of 300 random steps, with a leading time axis."""
    _, _, states, timesteps = mjx_rollout()
    return stacked(states), stacked(timesteps)


def test_a_random_rollout_stays_finite_and_keeps_to_its_bays(rollout):
    floats = [x for x in jax.tree.leaves(rollout) if x.dtype.kind == "f"]
    assert len(floats) > 50
    assert all(np.isfinite(x).all() for x in floats)
    states, timesteps = rollout
    assert not timesteps.events.diverged.any()
    # It is a rollout worth looking at.
    assert timesteps.events.crashed.sum() > 20
    assert timesteps.events.timed_out.sum() > 20
    assert timesteps.events.hit_wall.any()
    assert timesteps.events.hit_parked_car.any()
    assert timesteps.events.hit_agent.any()
    check_occupancy(states.goal, states.parked_cars.bay, states.layout.bay_mask)


def test_step_counters_count_and_start_again_at_every_end(rollout):
    states, timesteps = rollout
    done = timesteps.terminated | timesteps.truncated
    before = np.concatenate([np.zeros_like(states.step[:1]), states.step[:-1]])
    np.testing.assert_array_equal(states.step, np.where(done, 0, before + 1))
    assert states.step.max() == mjx_env().config.episode.max_steps - 1


def test_metrics_and_rewards_are_sums_over_the_episode_and_terms(rollout):
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
    total = np.sum(list(terms.values()), axis=0)
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
    seen = named["goal_distance"][..., 0] * FAR
    np.testing.assert_allclose(seen, distance, atol=1e-4)


def test_each_lot_of_a_batch_keeps_its_own_layout(rollout):
    states, timesteps = rollout
    layouts = jax.device_get(mixed_lots())
    pairs = zip(*map(jax.tree.leaves, (states.layout, layouts)), strict=True)
    for mine, given in pairs:
        np.testing.assert_array_equal(mine, np.broadcast_to(given, mine.shape))
    # Cars of the compact lots (odd) end within their smaller walls.
    reach = np.abs(timesteps.motion.pose_w[..., :2]).max(axis=(0, 2, 3))
    assert (reach[1::2] < layouts.extent[1, 0]).all()
    assert (reach[::2] < layouts.extent[0, 0]).all()


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


ONE_CAR = np.zeros((LOTS, 3), bool)
ONE_CAR[1, 0] = True  # agent 0 of lot 1


def stepped_pair(change):
    """One step from the same state, as it is and with something changed."""
    state, _ = mjx_start(2)
    action = np.random.default_rng(2).uniform(-1, 1, (LOTS, 3, 2)).astype(np.float32)
    for _ in range(5):
        state, _ = mjx_step()(state, action)
    plain, timestep = mjx_step()(state, action)
    return jax.device_get(timestep), state, plain, *mjx_step()(change(state), action)


def unaffected(plain, changed):
    """Whether the physics of all cars but one agree bit for bit."""
    return same(
        *(jax.tree.map(lambda x: x[~ONE_CAR], s.physics) for s in (plain, changed))
    )


def test_the_others_drive_on_bit_for_bit_when_an_agent_respawns():
    def almost_over(state):
        last = mjx_env().config.episode.max_steps - 1
        return state.replace(step=state.step.at[1, 0].set(last))

    plain_step, _, plain, changed, timestep = stepped_pair(almost_over)
    assert not plain_step.events.done.any()
    np.testing.assert_array_equal(timestep.events.done, ONE_CAR)
    assert unaffected(plain, changed)
    assert not np.array_equal(plain.motion.pose_w[1, 0], changed.motion.pose_w[1, 0])
    np.testing.assert_array_equal(timestep.reward, plain_step.reward)


def test_a_car_that_turns_nan_is_put_out_and_nobody_else_notices():
    def poisoned(state):
        qvel = state.physics.qvel.at[1, 0, 3].set(jnp.nan)
        return state.replace(physics=state.physics.replace(qvel=qvel))

    plain_step, before, plain, after, timestep = stepped_pair(poisoned)
    for flags in (timestep.events.diverged, timestep.events.done, timestep.truncated):
        np.testing.assert_array_equal(flags, ONE_CAR)
    assert not timestep.terminated.any()
    np.testing.assert_array_equal(timestep.metrics["diverged"], ONE_CAR)
    assert float(timestep.reward[1, 0]) == 0.0
    assert all(float(term[1, 0]) == 0.0 for term in timestep.reward_terms.values())
    others = np.asarray(timestep.reward)[~ONE_CAR]
    np.testing.assert_array_equal(others, plain_step.reward[~ONE_CAR])
    # Back at its last finite pose for the metrics, then in a new episode.
    found, last = timestep.motion.pose_w[1, 0], before.motion.pose_w[1, 0]
    np.testing.assert_allclose(found, last, atol=1e-6)
    assert int(after.step[1, 0]) == 0
    assert after.motion.finite.all()
    finite = [np.isfinite(x) for x in leaves((after, timestep)) if x.dtype.kind == "f"]
    assert all(x.all() for x in finite)
    assert unaffected(plain, after)
    later, _ = mjx_step()(after, jnp.zeros((LOTS, 3, 2)))
    assert later.motion.finite.all()


# Arguments that are refused, states passed on, gradients


def test_float64_is_refused():
    env, reset, step = slide()
    state = reset(jax.random.key(0))[0]
    calls = (
        ParkingEnv,
        lambda: reset(jax.random.key(0)),
        lambda: step(state, HALT),
        lambda: env.draw_layout(jax.random.key(0)),
    )
    with jax.enable_x64(True):
        for call in calls:
            with pytest.raises(ValueError, match="must be False, not T"):
                call()


def test_a_mesh_with_explicit_axes_shards_what_is_mapped():
    env, *_ = slide()
    lots = jax.P("lots")

    def drive(key):
        return env.step(env.reset(key)[0], HALT)[1]

    with jax.set_mesh(jax.make_mesh((1,), ("lots",))):
        keys = jax.device_put(jax.random.split(jax.random.key(0), 2), lots)
        shapes = jax.eval_shape(jax.vmap(drive), keys)
        assert all(x.sharding.spec[0] == "lots" for x in jax.tree.leaves(shapes))


MESHES = """
import jax
import numpy as np
from helpers.sliding import HALT, slide

env, *_ = slide()
lots, keys = jax.P("lots"), jax.random.split(jax.random.key(0), 4)
drive = jax.vmap(lambda key: env.step(env.reset(key)[0], HALT)[1])
wanted = jax.jit(drive)(keys)


def assert_split(found):
    for one, other in zip(*map(jax.tree.leaves, (found, wanted)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)
        assert len(one.sharding.device_set) == jax.device_count() == 2
        assert one.addressable_shards[0].data.shape[0] == 2


kinds = jax.sharding.AxisType
for kind in (kinds.Auto, kinds.Explicit):  # JAX compiles nothing over manual ones
    mesh = jax.make_mesh((2,), ("lots",), (kind,))
    own = jax.device_put(keys, jax.NamedSharding(mesh, lots))
    specs = {"in_specs": lots, "out_specs": lots, "check_vma": False}
    assert_split(jax.jit(jax.shard_map(drive, mesh=mesh, **specs))(own))
with jax.set_mesh(mesh):  # explicit axes need no `shard_map`
    assert_split(jax.jit(drive)(jax.device_put(keys, lots)))
"""


@pytest.mark.slow
def test_two_devices_share_lots_on_meshes_of_both_axis_types():
    path = f"{ROOT}:{ROOT / 'tests'}"
    done = python("-c", MESHES, JAX_NUM_CPU_DEVICES="2", PYTHONPATH=path)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_eager_results_can_be_donated():
    env, *_ = slide()
    step = jax.jit(env.step, donate_argnums=0)
    state, _ = env.reset(jax.random.key(0))
    state, _ = step(state, HALT)
    state, timestep = env.step(state, HALT)
    step(state, HALT)
    assert np.isfinite(timestep.motion.pose_w).all()
    env.reset(jax.random.key(0))  # its constants are still there


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"split": "foo"}, "unknown split 'foo'"),
        ({"num_present": 1.5}, "num_present must be a whole number"),
        ({"num_present": np.ones(2, int)}, "num_present must be a whole"),
        ({"member": 1}, r"member must lie in \[0, 0\], not 1"),
    ],
)
def test_a_reset_refuses_what_has_no_meaning(change, message):
    with pytest.raises(ValueError, match=message):
        slide()[0].reset(jax.random.key(0), **change)


def test_orbax_saves_a_state_from_which_a_lot_goes_on(tmp_path):
    env, reset, step = slide()
    state, _ = reset(jax.random.key(0))
    assert any(x.size == 0 for x in jax.tree.leaves(state))  # there are no discs
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save(tmp_path / "state", without_empty(state))
    like = jax.eval_shape(env.reset, jax.random.key(0))[0]
    with ocp.StandardCheckpointer() as checkpointer:
        saved = checkpointer.restore(tmp_path / "state", without_empty(like))
    restored = with_empty(saved, like)
    assert same(restored, state)
    assert same(step(restored, HALT), step(state, HALT))


STEPS, AGENTS = 3, 2
PROBE = 2e-2  # of an action: coordinates are rounded to 1e-6 m
SMOOTH = ("progress", "smoothness", "closeness")


@pytest.fixture(scope="module")
def drive():
    """Sums of smooth rewards, poses and observations by actions (steps, agents, 2)."""
    reward = RewardConfig(progress=10.0, closeness=5000.0, extra={"smoothness": 100.0})
    config = EnvConfig(
        physics="bicycle", num_agents=AGENTS, num_parked_cars=2, reward=reward
    )
    env = ParkingEnv(config)
    start, _ = jax.jit(env.reset)(jax.random.key(0))

    def run(actions):
        def step(state, action):
            state, timestep = env.step(state, action)
            terms = [timestep.reward_terms[name].sum() for name in SMOOTH]
            return state, (jnp.stack(terms), timestep.observation.sum())

        end, (terms, observed) = jax.lax.scan(step, start, actions)
        pose = end.motion.pose_w.sum(axis=0)
        return jnp.concatenate([pose, terms.sum(axis=0), observed.sum()[None]])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rewards, "CLOSENESS_RANGE", 40.0)
        yield jax.jit(run), jax.jit(jax.jacrev(run))


def test_gradients_are_central_differences_and_finite_at_rest(drive):
    run, slopes = drive
    rng = np.random.default_rng(0)
    # To one side, for smoothness is |change|, and slower than the steering's limit.
    steer = np.linspace(0.05, 0.2, STEPS)[:, None] + rng.uniform(0, 0.02, (1, AGENTS))
    pedal = rng.uniform(0.3, 0.8, (STEPS, AGENTS))
    actions = np.float32(np.stack([steer, pedal], axis=-1))
    found = np.asarray(slopes(actions))
    assert np.isfinite(found).all()
    for row in range(len(found) - 1):  # observations have kinks
        way = np.sign(found[row])
        gained = run(actions + PROBE * way) - run(actions - PROBE * way)
        expected = pytest.approx(np.abs(found[row]).sum(), rel=1e-2)
        assert gained[row] / (2 * PROBE) == expected, row
        assert np.abs(found[row]).max() > 1e-2
    assert np.isfinite(slopes(np.zeros((STEPS, AGENTS, 2), np.float32))).all()

"""The environment with the real car, its arguments, states passed on, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import pytest
from helpers.scenes import (
    LOTS,
    check_occupancy,
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


def test_a_car_that_turns_nan_is_put_out_and_nobody_else_notices():
    before, _ = mjx_start(2)
    action = np.random.default_rng(2).uniform(-1, 1, (LOTS, 3, 2)).astype(np.float32)
    for _ in range(5):
        before, _ = mjx_step()(before, action)
    plain, plain_step = mjx_step()(before, action)
    qvel = before.physics.qvel.at[1, 0, 3].set(jnp.nan)
    poisoned = before.replace(physics=before.physics.replace(qvel=qvel))
    after, timestep = mjx_step()(poisoned, action)
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
    each = (jax.tree.map(lambda x: x[~ONE_CAR], x.physics) for x in (plain, after))
    assert same(*each)
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

"""Arguments of an environment that are refused, states passed on, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
import pytest
from helpers.programs import ROOT, python
from helpers.sliding import HALT, slide
from helpers.trees import same

from carpark_mj.config import EnvConfig, RewardConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp import rewards
from carpark_mj.types import with_empty, without_empty


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

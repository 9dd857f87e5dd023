"""Warm starts take the networks of another run and nothing else."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.training.types import UInt64
from helpers.learning import sliding_learner
from helpers.tiny_policy import parked_learner
from helpers.trees import assert_close, same

from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.config import EnvConfig, RayConfig, ShareConfig, insert
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.policy.loading import save_policy
from carpark_mj.policy.networks import NetworkConfig, init_normalizer, update_normalizer
from carpark_mj.policy.widening import Trained, widen
from carpark_mj.training.ppo.group import make_learner
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.train import load_or_init, save
from carpark_mj.training.ppo.warm_start import require_run, warm_start

NETWORKS = ("normalizer", "policy", "average", "value")
TINY = dataclasses.replace(
    PRESETS["cpu"],
    num_lots=2,
    unroll_length=8,
    num_minibatches=1,
    networks=NetworkConfig((16,), (16,), own_size=8, entity_size=8),
    env=EnvConfig(physics="bicycle", num_agents=2),
)


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """Folder and state of a run whose every float was moved."""
    folder = tmp_path_factory.mktemp("other")
    state = jax.device_get(parked_learner(TINY).init())
    rng = np.random.default_rng(0)
    moved = {
        name: jax.tree.map(
            lambda x: (x + rng.uniform(0.5, 1.0, x.shape)).astype(x.dtype), tree
        )
        for name, tree in vars(state).items()
        if name in (*NETWORKS, "optimizer")
    }
    state = dataclasses.replace(state, **moved, update=np.int32(7))
    save(folder, TINY, state)
    return folder, state


def test_networks_and_statistics_are_taken_and_the_rest_is_new(other, tmp_path):
    folder, theirs = other
    assert not same(theirs.policy, theirs.average)
    # The policy that was evaluated goes on, not the last one.
    theirs = dataclasses.replace(theirs, policy=theirs.average)
    wider = dataclasses.replace(TINY.networks, min_std=0.1)  # no weight's shape
    config = dataclasses.replace(TINY, seed=3, networks=wider)
    learner, state = started(config, folder, tmp_path)
    own = learner.init()
    for name in vars(own):
        expected = getattr(theirs if name in NETWORKS else own, name)
        if jax.tree.leaves(expected):
            assert same(getattr(state, name), expected), name
    assert state.update == 0


def started(config, run, folder):
    """A learner that starts from a run, and its state."""
    learner = parked_learner(dataclasses.replace(config, warm_start=str(run)))
    return learner, jax.device_get(load_or_init(learner, [folder / "run"]))


@pytest.mark.slow
def test_of_runs_side_by_side_each_has_its_own_warm_start(other, tmp_path):
    folder, theirs = other
    starts = ("", str(folder))
    learner = make_learner([dataclasses.replace(TINY, warm_start=s) for s in starts])
    fresh, warm = learner.split(load_or_init(learner, [tmp_path / "a", tmp_path / "b"]))
    assert_close(warm.policy, theirs.average, atol=1e-6)
    assert_close(fresh.policy, parked_learner(TINY).init().average, atol=1e-6)


def test_a_resumed_run_goes_on_from_its_own_checkpoint(other, tmp_path):
    folder, _ = other
    config = dataclasses.replace(TINY, warm_start=str(folder))
    own = jax.device_get(parked_learner(TINY).init())
    save(tmp_path, config, own)
    state = load_or_init(parked_learner(config), [tmp_path])
    jax.tree.map(np.testing.assert_array_equal, state.policy, own.policy)


def test_a_policy_alone_rests_while_a_critic_learns(other, tmp_path):
    folder, theirs = other
    alone = tmp_path / "alone.npz"
    save_policy(folder, alone)
    # A step more than one update: two.
    steps = TINY.steps_per_update + 1
    config = dataclasses.replace(TINY, warm_start=str(alone), critic_steps=steps)
    require_run(config)
    learner = sliding_learner(config)
    state = load_or_init(learner, [tmp_path / "run"])
    start = jax.device_get(state)
    for actor in (start.policy, start.average):
        assert same(actor, theirs.average)
    assert same(start.normalizer, theirs.normalizer)
    assert same(start.value, jax.device_get(parked_learner(config).init()).value)
    update, moved = learner.compile(), []
    for _ in range(3):
        state, _ = update(state)
        now = jax.device_get(state)
        parts = (now.policy, start.policy), (now.value, start.value)
        moved.append([not same(*part) for part in parts])
    assert moved == [[False, True], [False, True], [True, True]]
    assert now.skipped == 0


SHARE = ShareConfig(steering=True, priority=True)
MORE = ContinuousObservation(
    own_car=True, own_gear=True, own_past=True, lines=True, share=SHARE
)
WIDER = insert(TINY, {"env.observation": MORE, "networks.own_size": 16})
NEW = {"own_size", "own_wheelbase", "own_rear_axle", "own_turning_radius"}
NEW |= {
    "own_time",
    "own_changes",
    "own_turns",
    "own_gear",
    "line_room",
    "agent_0_steering",
    "agent_0_priority",
}


def names_of(env):
    """The field of every column of the observation vector."""
    return np.array([f.name for f in make_fields(env) for _ in range(f.size)])


def outputs(learner, state, network, params, observation):
    """What the actor or the critic of a state makes of observations."""
    apply = getattr(learner.networks, f"{network}_network").apply
    return jax.jit(apply)(state.normalizer, params, observation)


@pytest.mark.slow
def test_a_policy_alone_is_widened_too(other, tmp_path):
    save_policy(other[0], tmp_path / "alone.npz")
    alone = {"warm_start": str(tmp_path / "alone.npz"), "critic_steps": 1}
    config = dataclasses.replace(WIDER, **alone)
    state = load_or_init(parked_learner(config), [tmp_path / "run"])
    # An update donates both: XLA aborts if memory is donated twice.
    both = jax.tree.leaves((state.policy, state.average))
    memory = {x.addressable_data(0).unsafe_buffer_pointer() for x in both}
    assert len(memory) == len(both)
    state = jax.device_get(state)
    _, expected = started(WIDER, other[0], tmp_path)
    for name in ("normalizer", "average"):
        assert same(getattr(state, name), getattr(expected, name))
    assert same(state.policy, expected.average)
    assert same(state.value, jax.device_get(parked_learner(config).init()).value)


def test_agents_that_observe_more_act_as_before_and_learn(other, tmp_path):
    folder, theirs = other
    narrow, (wide, state) = parked_learner(TINY), started(WIDER, folder, tmp_path)
    names, rng = names_of(WIDER.env), np.random.default_rng(1)
    more = rng.uniform(-1, 1, (50, names.size)).astype(np.float32)
    less = more[:, ~np.isin(names, sorted(NEW))]
    assert less.shape[1] == names_of(TINY.env).size < more.shape[1]
    for network, old, new in (
        ("policy", theirs.average, state.policy),
        ("policy", theirs.average, state.average),
        ("value", theirs.value, state.value),
    ):
        before = outputs(narrow, theirs, network, old, less)
        after = outputs(wide, state, network, new, more)
        np.testing.assert_allclose(after, before, rtol=1e-5, atol=1e-5)

    def loss(params):
        return jnp.sum(outputs(wide, state, "value", params, more) ** 2)

    slopes = jax.jit(jax.grad(loss))(state.value)["params"]
    slope = slopes["SetEncoder_0"]["own"]["kernel"]
    assert (np.abs(slope).max(axis=1) > 0).all()


def own_names(env):
    """The field of every own number of an agent."""
    fields = [field for field in make_fields(env) if not field.group]
    return np.array([field.name for field in fields for _ in range(field.size)])


def test_statistics_of_new_fields_have_unit_variance_and_go_on(other):
    _, theirs = other
    count = UInt64(hi=np.uint32(0), lo=np.uint32(10_000))
    seen = {
        part: state.replace(count=count, std_eps=0.0)
        for part, state in theirs.normalizer.items()
    }
    trained, nothing = Trained("narrow", TINY.networks, TINY.env), {"normalizer": {}}
    wide = widen(WIDER.networks, WIDER.env, trained, {"normalizer": seen}, nothing)
    wide, inputs = wide["normalizer"], parked_learner(WIDER).inputs
    new = np.isin(own_names(WIDER.env), sorted(NEW))
    np.testing.assert_array_equal(wide["own"].mean[new], 0.0)
    np.testing.assert_array_equal(wide["own"].std[new], 1.0)
    np.testing.assert_array_equal(wide["own"].std[~new], theirs.normalizer["own"].std)
    observed = np.full((10_000, inputs.size), 3.0, np.float32)
    again = update_normalizer(inputs, wide, observed)["own"]
    # Half of the numbers seen are 3, the others were of mean 0 and variance 1.
    np.testing.assert_allclose(again.mean[new], 1.5, rtol=1e-4)
    np.testing.assert_allclose(again.std[new] ** 2, 0.5 + 1.5**2, rtol=1e-3)


def with_rays(count, **more):
    rays = {"env.observation": ContinuousObservation(rays=RayConfig(count, **more))}
    return insert(TINY, rays)


def test_rays_of_another_reach_are_refused(other):
    config = with_rays(72, near=0.0, reach=20.0)
    config = dataclasses.replace(config, warm_start=str(other[0]))
    with pytest.raises(ValueError, match="trained on other observations: rays"):
        warm_start(config, other[1])


@pytest.mark.parametrize(
    ("less", "more", "new"),
    [
        (ContinuousObservation(3, 0), ContinuousObservation(), "parked_car"),
        (ContinuousObservation(), CameraObservation(width=4, height=3), "camera"),
    ],
)
def test_a_new_part_is_learned_from(less, more, new, tmp_path):
    narrow = parked_learner(insert(TINY, {"env.observation": less}))
    theirs = jax.device_get(narrow.init())
    save(tmp_path, narrow.config, theirs)
    config = insert(TINY, {"env.observation": more})
    wide, state = started(config, tmp_path, tmp_path)
    names, rng = names_of(config.env), np.random.default_rng(3)
    kept = ~np.char.startswith(names, new)
    assert not kept.all()
    more = rng.uniform(0.6, 1, (20, names.size)).astype(np.float32)
    before = outputs(narrow, theirs, "value", theirs.value, more[:, kept]).sum()

    def total(params):
        return outputs(wide, state, "value", params, more).sum()

    after, slopes = jax.jit(jax.value_and_grad(total))(state.value)
    assert float(after) == pytest.approx(float(before), rel=1e-5)
    slope = slopes["params"]["MLP_0"]["hidden_0"]["kernel"]
    assert (np.abs(slope).max(axis=1) > 0).all()


@pytest.mark.parametrize("name", ["rays", "rays_near"])
def test_more_rays_take_over_those_of_the_same_bearings(name):
    """Every third of 72 bearings is one of 24."""
    few, many = (with_rays(count, near=1.0) for count in (24, 72))
    old, new = (own_names(config.env) == name for config in (few, many))
    theirs = init_normalizer(parked_learner(few).inputs)
    numbered = np.arange(old.size, dtype=np.float32)
    theirs = theirs | {"own": theirs["own"].replace(mean=numbered)}
    trained, nothing = Trained("few", few.networks, few.env), {"normalizer": {}}
    wide = widen(many.networks, many.env, trained, {"normalizer": theirs}, nothing)
    found = np.asarray(wide["normalizer"]["own"].mean)[new]
    np.testing.assert_array_equal(found[::3], numbered[old])
    np.testing.assert_array_equal(np.delete(found, np.s_[::3]), 0.0)

"""Networks over observations, and the statistics that normalise these."""

import dataclasses
import functools
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import python

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.mdp.actions import ActionSpec, action_spec
from carpark_mj.observations import make_fields
from carpark_mj.observations.compose import OWN, EntitySet, ObservationSets
from carpark_mj.observations.ego import LONG
from carpark_mj.observations.fields import Field
from carpark_mj.policy import entities
from carpark_mj.policy.distributions import action_distribution
from carpark_mj.policy.networks import (
    DITHERS,
    MIN_DEVIATION,
    Arithmetic,
    NetworkConfig,
    init_normalizer,
    make_finish,
    make_networks,
    make_policy,
    network_inputs,
    normalize,
    update_normalizer,
)

CONFIG = NetworkConfig((16,), (16,), own_size=12, entity_size=8)
MANY = EnvConfig(num_agents=4, num_parked_cars=3, goals=GoalConfig(True, 2))
FEW = dataclasses.replace(MANY, num_agents=2, num_parked_cars=1)
ALONE = dataclasses.replace(MANY, num_agents=1, num_parked_cars=0)
KINDS = ("agent", "parked_car")
PLAIN = Arithmetic()


class Net:
    """Actor and critic of an environment."""

    def __init__(self, env, config=CONFIG, arithmetic=PLAIN):
        fields = make_fields(env)
        self.inputs = network_inputs(config, fields)
        self.networks = make_networks(config, fields, action_spec(env), arithmetic)
        self.run = jax.jit(self.__call__)
        self.init = jax.jit(self._init)

    def _init(self):
        """Weights, and statistics of random numbers."""
        key, normalizer = jax.random.key(0), init_normalizer(self.inputs)
        seen = 2.0 + 3.0 * jax.random.normal(key, (40, self.inputs.size))
        normalizer = update_normalizer(self.inputs, normalizer, seen)
        actor = self.networks.policy_network.init(key)
        return normalizer, actor, self.networks.value_network.init(key)

    def __call__(self, weights, observation):
        """What the actor and the critic make of observations, together."""
        normalizer, actor, critic = weights
        action = self.networks.policy_network.apply(normalizer, actor, observation)
        value = self.networks.value_network.apply(normalizer, critic, observation)
        return jnp.concatenate([action, value[..., None]], axis=-1)


def seen(inputs, lots=5):
    """Parts of random observations of which all entities are present."""
    rng = np.random.default_rng(1)
    vector = rng.normal(size=(lots, inputs.size)).astype(np.float32)
    parts = {name: np.array(x) for name, x in inputs.split(jnp.asarray(vector)).items()}
    for part in inputs.sets:
        parts[part.group][..., part.mask] = 1.0
    return parts


def joined(inputs, parts):
    """The vectors that are taken apart into these parts."""
    place = inputs.split(jnp.arange(inputs.size))
    vector = np.zeros((len(parts[OWN]), inputs.size), np.float32)
    for name, part in parts.items():
        at = np.asarray(place[name]).reshape(-1)
        vector[:, at] = part.reshape(len(part), -1)
    return jnp.asarray(vector)


@pytest.fixture(scope="module")
def many():
    net = Net(MANY)
    return net, net.init()


def outputs(many, *changed):
    """Outputs for the parts as they are and as changed."""
    net, weights = many
    found = np.stack([net.run(weights, joined(net.inputs, p)) for p in changed])
    assert np.isfinite(found).all()
    return found


def differ(a, b):
    """Of each output, the largest difference in any lot."""
    return np.abs(a - b).max(axis=0)


def test_brax_is_whole_for_others():
    """Its own first module waits until it is asked for a name."""
    for names in "brax; brax.State", "brax.base, brax.io.html", "brax.mjx.pipeline":
        done = python("-c", f"import carpark_mj.policy.networks, {names}")
        assert not done.returncode, done.stderr


def test_the_order_of_cars_changes_no_output_that_of_bays_does(many):
    parts = seen(many[0].inputs)
    for kind in KINDS:
        mixed = parts | {kind: parts[kind][:, ::-1]}
        replaced = parts | {kind: parts[kind][:, [0, 0, 1]]}  # it was read
        same, turned, other = outputs(many, parts, mixed, replaced)
        assert differ(same, turned).max() < 1e-6
        assert differ(same, other)[[0, -1]].min() > 1e-4
    same, turned = outputs(many, parts, parts | {"bay": parts["bay"][:, ::-1]})
    assert differ(same, turned)[[0, -1]].min() > 1e-4


@pytest.mark.parametrize("kind", [*KINDS, "bay"])
def test_what_absent_entities_hold_does_not_matter(many, kind):
    inputs = many[0].inputs
    [mask] = [part.mask for part in inputs.sets if part.group == kind]
    parts = seen(inputs)
    parts[kind][:, 1, mask] = 0.0
    spoilt = parts[kind].copy()
    spoilt[:, 1] += 7.0
    spoilt[:, 1, mask] = 0.0
    same, other = outputs(many, parts, parts | {kind: spoilt})
    np.testing.assert_array_equal(same, other)


@pytest.mark.parametrize("env", [FEW, ALONE], ids=["few", "alone"])
def test_the_same_weights_drive_any_number_of_cars(many, env):
    """The others being absent, the output is that among fewer slots."""
    net, weights = many
    small = Net(env)
    own = jax.eval_shape(small.init)
    assert jax.tree.map(jnp.shape, weights) == jax.tree.map(jnp.shape, own)
    parts = seen(net.inputs)
    if env is ALONE:
        parts |= {kind: np.zeros_like(parts[kind]) for kind in KINDS}
    fewer = parts | {kind: parts[kind][:, :1] for kind in KINDS}
    padded = {kind: np.zeros_like(parts[kind]) for kind in KINDS}
    for kind in KINDS:
        padded[kind][:, 2] = parts[kind][:, 0]  # in another slot at that
    [expected] = outputs(many, parts | padded)
    found = np.asarray(small.run(weights, joined(small.inputs, fewer)))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_gradients_are_finite_where_a_set_is_empty(many):
    net, weights = many
    parts = seen(net.inputs)
    empty = {kind: np.zeros_like(parts[kind]) for kind in (*KINDS, "bay")}
    observed = joined(net.inputs, parts | empty)

    def loss(networks, observed):
        return jnp.sum(net((weights[0], *networks), observed) ** 2)

    grads, grad = jax.jit(jax.grad(loss, argnums=(0, 1)))(weights[1:], observed)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves((grads, grad)))
    assert np.abs(grad).max() > 1e-3
    for path, x in jax.tree_util.tree_leaves_with_path(grads):
        if any(group in str(path) for group in (*KINDS, "bay")):
            assert np.abs(x).max() == 0.0, path  # nothing was there to learn from


def test_arithmetic_of_training_changes_no_parameter(monkeypatch):
    calls = []
    kernel = functools.partial(entities.largest_in_kernel, interpret=True)
    monkeypatch.setattr(
        entities, "largest_in_kernel", lambda *args: calls.append(args) or kernel(*args)
    )
    config = dataclasses.replace(CONFIG, entity_size=16)
    plain = Net(MANY, config)
    fast = Net(MANY, config, Arithmetic(in_kernel=True, dtype=jnp.bfloat16))
    weights = plain.init()
    jax.tree.map(np.testing.assert_array_equal, fast.init(), weights)
    vector = joined(plain.inputs, seen(plain.inputs))
    expected, found = plain(weights, vector), fast(weights, vector)
    assert len(calls) == 4 * 2  # kinds of cars, actor and critic, init and run
    assert found.dtype == jnp.float32
    error = np.abs(found - expected).max() / np.abs(expected).max()
    assert 0.0 < error < 2.0**-4


SETS = ObservationSets(11, (EntitySet("agent", 2, 3, 2, 0),))  # own: 0, 1, 8, 9, 10
SHAPE = (2, 6, 11)  # updates, observations
WEIGHT = np.array([[1, 0, 1, 1, 0, 1], [0, 1, 1, 0, 1, 1]], np.float32)


@pytest.fixture(scope="module")
def counted():
    rng = np.random.default_rng(0)
    vectors = rng.normal(3.0, 2.0, SHAPE).astype(np.float32)
    vectors[..., 10] = 0.25  # the same always
    entities = vectors[..., 2:8].reshape(*SHAPE[:2], 3, 2)
    entities[..., 0] = 1.0  # says that it is there
    entities *= rng.random((*SHAPE[:2], 3, 1)) < 0.6
    vectors[..., 2:8] = entities.reshape(*SHAPE[:2], 6)
    return vectors


def pooled(vectors):
    """Own numbers (n, 5), and those of entities that are there (k, 2), of (n, 11)."""
    entities = np.concatenate([vectors[:, i : i + 2] for i in (2, 4, 6)])
    own = vectors[:, [0, 1, 8, 9, 10]]
    return {OWN: own, "agent": entities[entities[:, 0] == 1.0]}


def assert_statistics(normalizer, vectors):
    for name, numbers in pooled(vectors.astype(float)).items():
        found = normalizer[name]
        assert int(found.count.lo) == len(numbers)
        np.testing.assert_allclose(found.mean, numbers.mean(axis=0), rtol=1e-5)
        expected = np.maximum(numbers.std(axis=0), MIN_DEVIATION)
        np.testing.assert_allclose(found.std, expected, rtol=1e-5)


def test_statistics_are_those_of_all_slots_and_updates_together(counted):
    normalizer = init_normalizer(SETS)
    for part in counted:
        normalizer = update_normalizer(SETS, normalizer, jnp.asarray(part))
    assert_statistics(normalizer, counted.reshape(-1, 11))


@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_what_devices_have_seen_is_added_together(counted, weight):
    def update(part, weight):
        return update_normalizer(SETS, init_normalizer(SETS), part, weight, "devices")

    each = jax.vmap(update, axis_name="devices")(jnp.asarray(counted), weight)
    counted = counted.reshape(-1, 11) if weight is None else counted[weight > 0]
    for device in (0, 1):
        assert_statistics(jax.tree.map(lambda x, i=device: x[i], each), counted)


def test_a_kind_unseen_has_the_statistics_of_the_start(counted):
    alone = counted.reshape(-1, 11).copy()
    alone[:, 2:8] = 0.0
    start = init_normalizer(SETS)
    normalizer = update_normalizer(SETS, start, jnp.asarray(alone))
    for a, b in zip(
        *map(jax.tree.leaves, (normalizer["agent"], start["agent"])), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    # And those of the first that it sees, once it does.
    later = update_normalizer(SETS, normalizer, jnp.asarray(counted[0]))
    expected = pooled(counted[0].astype(float))["agent"]
    np.testing.assert_allclose(later["agent"].mean, expected.mean(axis=0), rtol=1e-5)


def test_parts_are_scaled_alike_in_every_slot(counted):
    vectors = counted.reshape(-1, 11)
    normalizer = update_normalizer(SETS, init_normalizer(SETS), jnp.asarray(vectors))
    again = np.tile([1.0, 5.0], 3)  # the same entity in all slots
    vector = np.concatenate([[1.0, 2.0], again, [3.0, 4.0, 0.35]])
    found = normalize(normalizer, SETS.split(jnp.asarray(vector, jnp.float32)))
    numbers = pooled(vectors.astype(float))
    mean = numbers["agent"].mean(axis=0)
    std = np.maximum(numbers["agent"].std(axis=0), MIN_DEVIATION)
    expected = np.tile((np.array([1.0, 5.0]) - mean) / std, (3, 1))
    np.testing.assert_allclose(found["agent"], expected, rtol=1e-4)
    # What never varied is divided by the least deviation: (0.35 - 0.25) / 0.1.
    np.testing.assert_allclose(found[OWN][4], 0.1 / MIN_DEVIATION, rtol=1e-5)


def test_a_dither_draws_by_the_time_from_what_is_likely():
    config = NetworkConfig((8,), (8,), bins=3, dither=30.0)
    p, n = np.array([0.2, 0.5, 0.3], np.float32), 3 * DITHERS
    networks = SimpleNamespace(
        policy_network=SimpleNamespace(apply=lambda _, p, seen: p + 0 * seen[:, :1]),
        parametric_action_distribution=action_distribution(ActionSpec(1), bins=3),
    )
    fields = [Field("x", 2, -1.0, 1.0, ""), Field("own_time", 2, 0.0, 2.0, "")]
    finish = make_finish(config, fields, ActionSpec(1))
    policy = make_policy(networks, None, jnp.log(p), True, finish)
    time = 0.2 * np.arange(n) / LONG
    seen = jnp.asarray(np.stack([0 * time, 0 * time, time, 0 * time], 1), jnp.float32)
    action = np.asarray(policy(seen, jax.random.key(0))[0])[:, 0]
    np.testing.assert_array_equal(action[:150], 0.0)  # the likeliest for 30 s
    drawn = action[150 : 150 + DITHERS]
    share = (drawn[:, None] == [-1.0, 0.0, 1.0]).mean(axis=0)
    assert (np.abs(share - p) < 4 * np.sqrt(p * (1 - p) / DITHERS)).all()
    np.testing.assert_array_equal(action[150 + DITHERS :], action[150:-DITHERS])
    seen = seen.at[:, 2].add(0.1 / LONG)  # steps of 0.1 s, however they are rounded
    near = [policy(seen * (1 + x), jax.random.key(0))[0] for x in (-1e-6, 1e-6)]
    np.testing.assert_array_equal(*near)
    with pytest.raises(ValueError, match=r"observation\.own_past"):
        make_finish(config, fields[:1], ActionSpec(1))
    with pytest.raises(ValueError, match=r"networks\.mirrored"):  # nobody steers
        make_finish(NetworkConfig(bins=3, mirrored=True), fields, ActionSpec(0, (3, 5)))
    for wrong in ({"bins": 1}, {"dither": 1.0}):
        with pytest.raises(ValueError, match="bins"):
            NetworkConfig(**wrong)

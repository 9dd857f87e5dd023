"""Networks that read sets of cars: neither their order nor their number matters."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.mdp.actions import action_spec
from carpark_mj.observations import make_fields
from carpark_mj.observations.compose import OWN, ObservationSets
from carpark_mj.policy import entities
from carpark_mj.policy.networks import (
    Arithmetic,
    NetworkConfig,
    init_normalizer,
    make_networks,
    network_inputs,
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

    def __init__(
        self,
        env: EnvConfig,
        config: NetworkConfig = CONFIG,
        arithmetic: Arithmetic = PLAIN,
    ) -> None:
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


def seen(inputs: ObservationSets, lots: int = 5) -> dict[str, np.ndarray]:
    """Parts of random observations of which all entities are present."""
    rng = np.random.default_rng(1)
    vector = rng.normal(size=(lots, inputs.size)).astype(np.float32)
    parts = {name: np.array(x) for name, x in inputs.split(jnp.asarray(vector)).items()}
    for part in inputs.sets:
        parts[part.group][..., part.mask] = 1.0
    return parts


def joined(inputs: ObservationSets, parts: dict[str, np.ndarray]) -> jax.Array:
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


def differ(a, b) -> np.ndarray:
    """Of each output, the largest difference in any lot."""
    return np.abs(a - b).max(axis=0)


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_the_cars_of_a_kind_changes_neither_actor_nor_critic(many, kind):
    parts = seen(many[0].inputs)
    mixed = parts | {kind: parts[kind][:, ::-1]}
    replaced = parts | {kind: parts[kind][:, [0, 0, 1]]}  # one car less: it was read
    same, turned, other = outputs(many, parts, mixed, replaced)
    assert differ(same, turned).max() < 1e-6
    assert differ(same, other)[[0, -1]].min() > 1e-4


def test_tracked_bays_keep_their_slots(many):
    parts = seen(many[0].inputs)
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

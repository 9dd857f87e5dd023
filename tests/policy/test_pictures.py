"""Pictures in networks: beside the own numbers, the same layers for all views."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN, observation_sets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.encoder import patches
from carpark_mj.policy.networks import (
    Arithmetic,
    NetworkConfig,
    init_normalizer,
    make_networks,
    network_inputs,
    update_normalizer,
)

VIEWS, ABOVE = (2, 6, 5), (7, 3)  # no side is a multiple of the kernels'
KINDS = 4
FIELDS = (
    Field("speed", 1, -1.0, 1.0, ""),
    Field("depth", 60, 0.0, 1.0, "", shape=VIEWS),
    Field("turn", 2, -1.0, 1.0, ""),
    Field("seen", 60, 0.0, KINDS - 1.0, "", is_whole=True, shape=VIEWS),
    Field("above", 21, 0.0, 1.0, "", shape=ABOVE),
    Field("angle", 1, -1.0, 1.0, ""),
)
CONFIG = NetworkConfig((16,), (16,), own_size=8, picture_size=8)
INPUTS = network_inputs(CONFIG, FIELDS)
NETWORKS = make_networks(CONFIG, FIELDS, ActionSpec(2))


def observations(count=3):
    rng = np.random.default_rng(0)
    columns = [
        rng.integers(field.high + 1, size=(count, field.size))
        if field.is_whole
        else rng.uniform(field.low, field.high, (count, field.size))
        for field in FIELDS
    ]
    return np.concatenate(columns, axis=1).astype(np.float32)


def begin(key):
    networks = (NETWORKS.policy_network, NETWORKS.value_network)
    return init_normalizer(INPUTS), *(network.init(key) for network in networks)


WEIGHTS = jax.jit(begin)(jax.random.key(0))


def outputs(observation, networks=NETWORKS):
    """What the actor and the critic make of observations."""
    normalizer, actor, critic = WEIGHTS
    action = networks.policy_network.apply(normalizer, actor, observation)
    value = networks.value_network.apply(normalizer, critic, observation)
    return jnp.concatenate([action, value[..., None]], axis=-1)


def test_pictures_of_a_shape_are_channels_beside_the_own_numbers():
    vector = observations()
    parts = INPUTS.split(jnp.asarray(vector))
    np.testing.assert_array_equal(parts[OWN], vector[:, [0, 61, 62, 144]])
    views = np.stack([vector[:, 1:61], vector[:, 63:123]], axis=-1)
    np.testing.assert_array_equal(
        parts["pictures_2x6x5"], views.reshape(3, *VIEWS, len(("depth", "seen")))
    )
    np.testing.assert_array_equal(
        parts["pictures_7x3"], vector[:, 123:144].reshape(3, 1, *ABOVE, 1)
    )
    assert INPUTS.own_size == parts[OWN].shape[1]
    assert [part.kinds for part in INPUTS.pictures] == [(0, KINDS), (0,)]


def test_flat_networks_and_rows_have_no_pictures():
    flat = dataclasses.replace(CONFIG, encoder="flat")
    assert not network_inputs(flat, FIELDS).pictures
    assert not observation_sets([Field("x", 3, 0.0, 1.0, "", shape=(3,))]).pictures


def test_a_layer_of_patches_is_a_strided_convolution():
    pixels = jax.random.normal(jax.random.key(1), (2, 6, 5, 3))
    layer = linen.Conv(7, (4, 4), (4, 4), padding=((0, 2), (0, 3)))
    weights = layer.init(jax.random.key(2), pixels)["params"]
    found = patches(pixels, 4) @ weights["kernel"].reshape(-1, 7)
    expected = layer.apply({"params": weights}, pixels)
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("part", ["pictures_2x6x5", "pictures_7x3"])
def test_every_pixel_counts(part):
    grad = jax.jit(jax.jacrev(lambda x: outputs(x)[0]))(jnp.asarray(observations(1)))
    found = INPUTS.split(grad[..., 0, :])[part][..., 0]  # kinds have no slope
    assert np.isfinite(found).all()
    assert (np.abs(found).max(axis=0) > 0.0).all()


def test_kinds_and_the_order_of_views_matter():
    vector = observations()
    seen = vector[:, 63:123]
    other = vector.copy()
    other[:, 63:123] = (seen + 1.0) % KINDS
    turned = vector.copy()
    for start in (1, 63):
        views = turned[:, start : start + 60].reshape(3, *VIEWS)
        turned[:, start : start + 60] = views[:, ::-1].reshape(3, -1)
    same, changed, mixed = map(outputs, (vector, other, turned))
    for found in (changed, mixed):
        assert np.abs(found - same).max(axis=0)[[0, -1]].min() > 1e-4


def test_statistics_are_of_the_own_numbers_alone():
    normalizer = update_normalizer(INPUTS, WEIGHTS[0], jnp.asarray(observations(9)))
    assert normalizer.keys() == {OWN}
    assert normalizer[OWN].mean.shape == (4,)


def test_half_precision_changes_no_parameter_and_little_else():
    half = make_networks(CONFIG, FIELDS, ActionSpec(2), Arithmetic(dtype=jnp.bfloat16))
    own = jax.eval_shape(half.policy_network.init, jax.random.key(0))
    kinds = jax.tree.map(lambda x: (x.shape, x.dtype), WEIGHTS[1])
    assert kinds == jax.tree.map(lambda x: (x.shape, x.dtype), own)
    vector = observations()
    expected, found = outputs(vector), outputs(vector, half)
    error = np.abs(found - expected).max() / np.abs(expected).max()
    assert 0.0 < error < 2.0**-4

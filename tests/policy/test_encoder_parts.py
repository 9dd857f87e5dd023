"""Layers of entities, the GPU kernel that must compute the same, and pictures."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen
from helpers.compiling import text_for

from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations.compose import OWN, observation_sets
from carpark_mj.observations.fields import Field
from carpark_mj.policy import entities
from carpark_mj.policy.encoder import patches
from carpark_mj.policy.entities import EntityLayers
from carpark_mj.policy.networks import (
    Arithmetic,
    NetworkConfig,
    init_normalizer,
    make_networks,
    network_inputs,
    update_normalizer,
)

SIZE, FEATURES = 5, 16


def draw(shape, seed):
    return jnp.array(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def make_layers():
    return EntityLayers(
        first=(draw((SIZE, FEATURES), 0), draw((FEATURES,), 1)),
        norm=(1.0 + 0.3 * draw((FEATURES,), 2), draw((FEATURES,), 3)),
        second=(draw((FEATURES, FEATURES), 4), draw((FEATURES,), 5)),
    )


def in_kernel(layers, rows, present, dtype=jnp.float32):
    return entities.largest_in_kernel(layers, rows, present, dtype, interpret=True)


def test_layers_are_those_of_flax():
    layers, rows = make_layers(), draw((3, 4, SIZE), 6)

    def params(names, values):
        return {"params": dict(zip(names, values, strict=True))}

    dense, norm = linen.Dense(FEATURES), linen.LayerNorm(use_fast_variance=False)
    hidden = dense.apply(params(("kernel", "bias"), layers.first), rows)
    hidden = linen.swish(norm.apply(params(("scale", "bias"), layers.norm), hidden))
    expected = dense.apply(params(("kernel", "bias"), layers.second), hidden)
    np.testing.assert_allclose(entities.encode(layers, rows), expected, 1e-5, 1e-5)


@pytest.mark.parametrize("lead", [(), (3,), (2, entities.BLOCK + 1)])
def test_the_kernel_computes_the_same_with_the_same_gradients(lead):
    layers, rows = make_layers(), draw((*lead, 4, SIZE), 7)
    present = draw((*lead, 4), 8) > 0.0
    weight = draw((*lead, FEATURES), 9)

    def total(layers, largest):
        found = largest(layers, rows, present)
        assert found.shape == (*lead, FEATURES)
        return jnp.sum(weight * found)

    ours = jax.value_and_grad(total)(layers, in_kernel)
    expected = jax.value_and_grad(total)(layers, entities.largest)
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, 1e-3, 1e-3), ours, expected
    )
    everybody = jnp.ones_like(present)
    exact = entities.largest(layers, rows, everybody)
    half = in_kernel(layers, rows, everybody, jnp.bfloat16)
    error = np.abs(half - exact).max() / np.abs(exact).max()
    assert 0.0 < error < 2.0**-5  # bfloat16 has 8 bits, and products alone are in it


def test_the_kernel_is_lowered_for_gpus():
    layers, rows = make_layers(), draw((70, 4, SIZE), 12)
    present = jnp.ones((70, 4), bool)

    def total(layers):
        return entities.largest_in_kernel(layers, rows, present, jnp.bfloat16).sum()

    program = text_for("cuda", jax.grad(total), layers)
    assert program.count("__gpu$xla.gpu.triton") >= 2


@pytest.mark.parametrize(("features", "fits"), [(8, False), (16, True), (48, False)])
def test_the_kernel_takes_powers_of_two(features, fits):
    assert entities.fits(features) == fits


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


ACTOR, CRITIC = (
    jax.jit(network.init)(jax.random.key(0))
    for network in (NETWORKS.policy_network, NETWORKS.value_network)
)


def outputs(observation, networks=NETWORKS):
    """What the actor and the critic make of observations."""
    normalizer = init_normalizer(INPUTS)
    action = networks.policy_network.apply(normalizer, ACTOR, observation)
    value = networks.value_network.apply(normalizer, CRITIC, observation)
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
    flat = dataclasses.replace(CONFIG, encoder="flat")
    assert not network_inputs(flat, FIELDS).pictures
    assert not observation_sets([Field("x", 3, 0.0, 1.0, "", shape=(3,))]).pictures
    # Statistics are of the own numbers alone.
    normalizer = update_normalizer(INPUTS, init_normalizer(INPUTS), jnp.asarray(vector))
    assert normalizer.keys() == {OWN}
    assert normalizer[OWN].mean.shape == (4,)


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


def test_half_precision_changes_no_parameter_and_little_else():
    half = make_networks(CONFIG, FIELDS, ActionSpec(2), Arithmetic(dtype=jnp.bfloat16))
    own = jax.eval_shape(half.policy_network.init, jax.random.key(0))
    kinds = jax.tree.map(lambda x: (x.shape, x.dtype), ACTOR)
    assert kinds == jax.tree.map(lambda x: (x.shape, x.dtype), own)
    vector = observations()
    expected, found = outputs(vector), outputs(vector, half)
    error = np.abs(found - expected).max() / np.abs(expected).max()
    assert 0.0 < error < 2.0**-4

"""The layers of entities, and the GPU kernel that must compute the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen

from carpark_mj.policy import entities
from carpark_mj.policy.entities import EntityLayers

SIZE, FEATURES = 5, 16


def draw(shape: tuple[int, ...], seed: int) -> jax.Array:
    return jnp.array(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def make_layers() -> EntityLayers:
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


@pytest.mark.parametrize("largest", [entities.largest, in_kernel])
def test_absent_entities_and_their_order_do_not_matter(largest):
    layers, rows = make_layers(), draw((2, 4, SIZE), 10)
    present = jnp.array([[True, True, False, True], [False] * 4])
    found = largest(layers, rows, present)
    order = jnp.array([3, 0, 2, 1])
    moved = largest(layers, rows[:, order], present[:, order])
    np.testing.assert_allclose(moved, found, 1e-5, 1e-5)
    other = jnp.where(present[..., None], rows, 100.0)
    np.testing.assert_array_equal(largest(layers, other, present), found)
    assert not found[1].any()


def test_half_precision_is_that_of_products_alone():
    layers, rows = make_layers(), draw((8, 4, SIZE), 11)
    present = jnp.ones((8, 4), bool)
    exact = entities.largest(layers, rows, present)
    half = in_kernel(layers, rows, present, jnp.bfloat16)
    assert half.dtype == jnp.float32
    size = np.abs(exact).max()
    error = np.abs(half - exact).max() / size
    assert 0.0 < error < 2.0**-5  # bfloat16 has 8 bits


def test_the_kernel_is_lowered_for_gpus():
    layers, rows = make_layers(), draw((70, 4, SIZE), 12)
    present = jnp.ones((70, 4), bool)

    def total(layers):
        return entities.largest_in_kernel(layers, rows, present, jnp.bfloat16).sum()

    traced = jax.jit(jax.grad(total)).trace(layers)
    program = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert program.count("__gpu$xla.gpu.triton") >= 2


@pytest.mark.parametrize(("features", "fits"), [(8, False), (16, True), (48, False)])
def test_the_kernel_takes_powers_of_two(features, fits):
    assert entities.fits(features) == fits

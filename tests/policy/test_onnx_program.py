"""Programs of JAX as ONNX graphs: onnxruntime computes what JAX does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.geometry import boxes, norm, to_local, wrap_angle
from carpark_mj.policy.onnx_program import make_graph

onnxruntime = pytest.importorskip("onnxruntime")
RANDOM = np.random.default_rng(0)
X = RANDOM.normal(size=(4, 5)).astype(np.float32)
Y = RANDOM.normal(size=(4, 5)).astype(np.float32)
INDEX = np.array([3, -1, 0, 2], np.int32)
FLAGS = X > 0


def ran(function, *arrays):
    """The outputs of the graph of a function, in order."""
    names = "abcdef"
    inputs = {
        name: jax.ShapeDtypeStruct(array.shape, array.dtype)
        for name, array in zip(names, arrays, strict=False)
    }
    model = make_graph(lambda *x: {"out": function(*x)}, inputs)
    session = onnxruntime.InferenceSession(model.SerializeToString())
    needed = {value.name for value in session.get_inputs()}
    feed = {n: a for n, a in zip(names, arrays, strict=False) if n in needed}
    return session.run(None, feed)[0], needed


def loop(x):
    return jax.lax.fori_loop(0, 4, lambda _, carry: jnp.sin(carry) + x, x)


# By what they show; each of arrays of the given kinds.
CASES = {
    "arithmetic": (lambda x, y: x * y - x / (y + 9.0) + (-x) ** 3 + x**2, X, Y),
    "functions": (lambda x: jnp.tanh(x) + jnp.cos(x) * jnp.tan(x) + jnp.exp(x), X),
    "roots": (lambda x: jnp.sqrt(jnp.abs(x)) + jax.lax.rsqrt(x * x + 1.0), X),
    "rounding": (lambda x: jnp.floor(x) + jnp.ceil(3 * x) + jnp.sign(x), X),
    "sigmoid": (lambda x: jax.nn.sigmoid(x) * jax.nn.silu(x), X),
    "remainder": (lambda x, y: jnp.mod(x, 0.7) + jnp.mod(y, -0.3), X, Y),
    "limits": (
        lambda x, y: jnp.clip(jnp.maximum(x, y), -0.5, jnp.minimum(x, 1.0)),
        X,
        Y,
    ),
    "comparisons": (lambda x, y: (x < y) | (x >= 1.0) & ~(y <= 0.0) ^ (x != y), X, Y),
    "finite": (lambda x: jnp.isfinite(x / jnp.floor(x)), X),
    "choice of numbers": (lambda f, x, y: jnp.where(f, x, y), FLAGS, X, Y),
    "choice of flags": (lambda f, x, y: jnp.where(f, x > y, x < 0.0), FLAGS, X, Y),
    "whole numbers": (lambda i: (i * 3 + 1) % 4 + jnp.where(i < 0, -i, i), INDEX),
    "casts": (
        lambda f, i: f.astype(jnp.float32) + i[:, None].astype(jnp.float32),
        FLAGS,
        INDEX,
    ),
    "sums and extremes": (lambda x: jnp.stack([x.sum(1), x.max(1), x.min(1)]), X),
    "of none": (lambda x: jnp.min(x[:, :0], axis=1, initial=jnp.inf), X),
    "all and any": (lambda f: f.all(axis=0) | f.any(axis=1)[0], FLAGS),
    "nearest": (lambda x: jnp.stack([jnp.argmin(x, 1), jnp.argmax(x, 1)]), X),
    "broadcast": (lambda x: x[:, None] - x[None] + jnp.ones((2, 1, 1, 1)), X),
    "slices": (lambda x: x[1:3, ::2] + x[-2:, :3], X),
    "joined and cut": (lambda x, y: jnp.concatenate([x, y, x])[5:7] * x[:2], X, Y),
    "joined across": (lambda x, y: jnp.concatenate([x, y])[3:5], X, Y),
    "split": (lambda x: sum(jnp.split(x, [2, 4], axis=0)[:1]) + x[:1], X),
    "padding": (lambda x: jnp.pad(x, ((1, 0), (0, 2)), constant_values=7.0), X),
    "axes": (lambda x: jnp.moveaxis(x[None], 0, -1).reshape(5, 4).T, X),
    "rows": (lambda x, i: x[i], X, INDEX),
    "of rows": (lambda x, i: x[i, 1:3], X, INDEX),
    "cells": (lambda x, i: x[i, -i - 1], X, INDEX),
    "columns": (lambda x, i: x[:, i], X, INDEX),
    "in every row": (lambda x, i: jnp.take_along_axis(x, i[:, None], axis=1), X, INDEX),
    "beyond": (lambda x, i: x[i + 2**30], X, np.abs(INDEX)),
    "filled": (lambda x, i: jnp.take(x, i + 2, axis=0, fill_value=5.0), X, INDEX),
    "one of many": (lambda i: jax.nn.one_hot(i, 5), INDEX),
    "matrices": (lambda x, y: x @ y.T + 1.0, X, Y),
    "batches": (lambda x, y: jnp.einsum("bi,bi->b", x, y), X, Y),
    "outer": (lambda x, y: jnp.einsum("bi,ci,i->cb", x, y, x[0]), X, Y),
    "loop": (loop, X),
    "poses": (lambda x, y: to_local(x[:, :3], y[:, :3]), X, Y),
    "angles": (lambda x: wrap_angle(9.0 * x), X),
    "lengths": (lambda x: norm(x[..., :2]), X),
    "distances": (
        lambda x, y: boxes.box_distance(
            x[:, :3], x[:, 3:] ** 2, y[:, None, :3], y[:, None, 3:] ** 2
        ),
        X,
        Y,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_the_graph_computes_what_the_program_does(name):
    function, *arrays = CASES[name]
    expected = np.asarray(function(*map(jnp.asarray, arrays)))
    found, _ = ran(function, *arrays)
    assert found.shape == expected.shape
    assert found.dtype == expected.dtype
    np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-6)


def test_rays_along_walls_are_the_same_to_the_edge():
    """Infinite ways and 0 / 0, where a ray runs along an edge."""
    pose, size = jnp.array([[2.0, 0.0, 0.0]]), jnp.array([[2.0, 2.0]])
    along = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]], np.float32)[:, None]
    origin = np.array([[0.0, y] for y in (-1.5, -1.0, 0.0, 1.0)], np.float32)

    def ways(origin, along):
        return boxes.ray_box_distance(origin, along, pose, size)

    found, _ = ran(ways, origin, along)
    np.testing.assert_array_equal(found, ways(origin, along))
    assert np.isinf(found).any()


def test_only_what_is_read_is_an_input():
    found, needed = ran(
        lambda x, y, i: jnp.concatenate([x, y])[:2] + 0.0 * len(i), X, Y, INDEX
    )
    np.testing.assert_array_equal(found, X[:2])
    assert needed == {"a"}


def test_a_primitive_without_operator_is_named():
    with pytest.raises(NotImplementedError, match="cumsum"):
        ran(lambda x: jnp.cumsum(x), X)

"""Gradients of geometry: finite at corners, elsewhere central differences."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.geometry import box_distance, norm, ray_box_distance, reeds_shepp_length
from carpark_mj.geometry.se2 import arccos, arctan2, finite_slope, sqrt

BOX = jnp.array([4.0, 2.0])


def gap(pose):
    return box_distance(pose, BOX, jnp.zeros(3), BOX)


def ray(origin):
    return ray_box_distance(origin, jnp.array([0.0, 1.0]), jnp.zeros(3), BOX)


def way(pose):
    return reeds_shepp_length(pose, jnp.zeros(3), jnp.array(4.0))


@functools.cache
def slope(function):
    """Its gradient, compiled once for all points."""
    return jax.jit(jax.grad(function))


@pytest.mark.parametrize(
    ("function", "where"),
    [
        (norm, (0.0, 0.0)),
        (gap, (0.0, 0.0, 0.0)),
        (gap, (4.0, 0.0, 0.0)),
        (ray, (1.0, -5.0)),
        (ray, (3.0, -5.0)),
        (way, (0.0, 0.0, 0.0)),
        (way, (-5.0, 0.0, 0.0)),
        (way, (-16.0, 0.0, 0.0)),
    ],
    ids=["norm", "same box", "touching", "hit", "miss", "there", "ahead", "far"],
)
def test_gradients_are_finite_at_corners(function, where):
    assert np.isfinite(slope(function)(jnp.array(where))).all()


@pytest.mark.parametrize(
    ("function", "where"),
    [(gap, (5.0, 1.0, 0.3)), (ray, (1.0, -5.0)), (way, (-3.0, 2.5, 0.8))],
    ids=["gap", "ray", "way"],
)
def test_gradients_elsewhere_are_central_differences(function, where):
    with jax.enable_x64(True):
        found, where = slope(function)(jnp.array(where)), np.array(where)
        value = jax.jit(function)
        for k, step in enumerate(1e-6 * np.eye(len(where))):
            gained = value(where + step) - value(where - step)
            assert found[k] == pytest.approx(float(gained) / 2e-6, abs=1e-8)


@pytest.mark.parametrize(
    ("ours", "theirs", "args"),
    [
        (sqrt, jnp.sqrt, (2.0,)),
        (arccos, jnp.arccos, (0.3,)),
        (arctan2, jnp.arctan2, (3.0, -4.0)),
    ],
)
def test_values_and_slopes_are_those_of_the_function(ours, theirs, args):
    args = [jnp.float32(x) for x in args]
    every = tuple(range(len(args)))
    assert ours(*args) == theirs(*args)
    assert jax.grad(ours, every)(*args) == jax.grad(theirs, every)(*args)


def test_a_slope_that_is_not_finite_counts_as_0_for_its_own_argument_only():
    times = finite_slope(lambda a, b: a * jnp.sqrt(b))
    assert jax.grad(times, (0, 1))(2.0, 0.0) == (0.0, 0.0)
    assert jax.grad(times, (0, 1))(2.0, 4.0) == (2.0, 0.5)

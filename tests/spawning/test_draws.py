"""The random numbers of a start."""

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SpawnConfig
from carpark_mj.spawning.goals import place_shapes
from carpark_mj.spawning.starts import draw_uniform, pick, pick_weighted

KEYS = jax.random.split(jax.random.key(0), 4000)
LARGEST = np.float32(1 - 2**-23)  # of `jax.random.uniform`


def test_numbers_have_the_shapes_asked_for_and_are_uniform_and_independent():
    shapes = place_shapes(SpawnConfig(conflict_ratio=0.5), num_agents=2, num_bays=3)
    draws = jax.vmap(lambda key: draw_uniform(shapes, key))(KEYS)
    is_shape = lambda node: type(node) is tuple  # noqa: E731
    wanted = jax.tree.leaves(shapes, is_leaf=is_shape)
    got = jax.tree.leaves(draws)
    assert [x.shape[1:] for x in got] == wanted
    numbers = np.concatenate([np.reshape(x, (len(KEYS), -1)) for x in got], axis=1)
    assert 0.0 <= numbers.min() < numbers.max() < 1.0
    # Deviations 0.0046 and 0.0034 of each of 400 columns: five and a half of them.
    np.testing.assert_allclose(numbers.mean(axis=0), 0.5, atol=0.025)
    np.testing.assert_allclose(numbers.std(axis=0), 12**-0.5, atol=0.019)
    # No two columns share anything: a deviation of 0.016, six and a half of them.
    alike = np.corrcoef(numbers, rowvar=False) - np.eye(numbers.shape[1])
    assert np.abs(alike).max() < 0.1


def test_a_pick_is_uniform_over_the_mask():
    mask = jnp.array([False, True, False, True, True])
    scores = jax.random.uniform(jax.random.key(0), (3000, 5))
    picked = jax.vmap(lambda scores: pick(mask, scores))(scores)
    # Mean 1000, deviation 26: five of them.
    np.testing.assert_allclose(
        np.bincount(picked, minlength=5), [0, 1000, 0, 1000, 1000], atol=130
    )


def test_a_weighted_pick_is_in_proportion_to_the_weights():
    weights = jnp.array([0.0, 3.0, 0.0, 1.0, 2.0, 0.0])
    numbers = jax.random.uniform(jax.random.key(0), (3000, 2))
    picked = np.asarray(pick_weighted(weights, numbers))
    assert picked.shape == (3000, 2)
    # Deviations 39, 29 and 37: five of them.
    np.testing.assert_allclose(
        np.bincount(picked.ravel(), minlength=6), [0, 3000, 0, 1000, 2000, 0], atol=195
    )


def test_no_number_picks_what_has_no_weight():
    rng = np.random.default_rng(0)
    ends = jnp.array([0.0, LARGEST])
    for weights in rng.uniform(0.0, 300.0, (200, 7)).astype(np.float32):
        weights[[0, 3, 6]] = 0.0
        assert set(np.asarray(pick_weighted(jnp.asarray(weights), ends))) == {1, 5}

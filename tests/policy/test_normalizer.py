"""Statistics of observations: NumPy's, over all entities of a kind."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.observations.compose import OWN, EntitySet, ObservationSets
from carpark_mj.policy.networks import (
    MIN_DEVIATION,
    init_normalizer,
    normalize,
    update_normalizer,
)

SETS = ObservationSets(11, (EntitySet("agent", 2, 3, 2, 0),))  # own: 0, 1, 8, 9, 10
SHAPE = (2, 6, 11)  # updates, observations
WEIGHT = np.array([[1, 0, 1, 1, 0, 1], [0, 1, 1, 0, 1, 1]], np.float32)


@pytest.fixture(scope="module")
def seen():
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


def test_statistics_are_those_of_all_slots_and_updates_together(seen):
    normalizer = init_normalizer(SETS)
    for part in seen:
        normalizer = update_normalizer(SETS, normalizer, jnp.asarray(part))
    assert_statistics(normalizer, seen.reshape(-1, 11))


def test_observations_without_weight_do_not_count(seen):
    normalizer = init_normalizer(SETS)
    for part, weight in zip(seen, WEIGHT, strict=True):
        part = jnp.asarray(part).reshape(3, 2, 11)  # any leading dimensions
        weight = jnp.asarray(weight).reshape(3, 2)
        normalizer = update_normalizer(SETS, normalizer, part, weight)
    assert_statistics(normalizer, seen[WEIGHT > 0])


@pytest.mark.parametrize("weight", [None, WEIGHT])
def test_what_devices_have_seen_is_added_together(seen, weight):
    def update(part, weight):
        return update_normalizer(SETS, init_normalizer(SETS), part, weight, "devices")

    each = jax.vmap(update, axis_name="devices")(jnp.asarray(seen), weight)
    counted = seen.reshape(-1, 11) if weight is None else seen[weight > 0]
    for device in (0, 1):
        assert_statistics(jax.tree.map(lambda x, i=device: x[i], each), counted)


def test_empty_slots_change_no_statistics(seen):
    """A lot with more slots than cars teaches what one with as many does."""
    wider = ObservationSets(15, (EntitySet("agent", 2, 5, 2, 0),))
    vectors = seen.reshape(-1, 11)
    spaced = np.insert(vectors, [8] * 4, 0.0, axis=1)
    few, many = (
        update_normalizer(sets, init_normalizer(sets), jnp.asarray(x))
        for sets, x in ((SETS, vectors), (wider, spaced))
    )
    for a, b in zip(*map(jax.tree.leaves, (few, many)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6)


def test_a_kind_that_nobody_has_seen_yet_has_the_statistics_of_the_start(seen):
    alone = seen.reshape(-1, 11).copy()
    alone[:, 2:8] = 0.0
    start = init_normalizer(SETS)
    normalizer = update_normalizer(SETS, start, jnp.asarray(alone))
    for a, b in zip(
        *map(jax.tree.leaves, (normalizer["agent"], start["agent"])), strict=True
    ):
        np.testing.assert_array_equal(a, b)
    # And those of the first that it sees, once it does.
    later = update_normalizer(SETS, normalizer, jnp.asarray(seen[0]))
    expected = pooled(seen[0].astype(float))["agent"]
    np.testing.assert_allclose(later["agent"].mean, expected.mean(axis=0), rtol=1e-5)


def test_parts_are_scaled_by_their_statistics_alike_in_every_slot(seen):
    vectors = seen.reshape(-1, 11)
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

"""Observations taken apart into own numbers and sets of entities."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.observations.compose import OWN, observation_sets
from carpark_mj.observations.fields import Field

FIXED = EnvConfig(num_agents=4, num_parked_cars=5)
CONFIGS = {
    "fixed": FIXED,
    "alone": EnvConfig(num_agents=1, num_parked_cars=0),
    "blind": dataclasses.replace(
        FIXED, observation=ContinuousObservation(tracked_agents=0)
    ),
    "dynamic": dataclasses.replace(FIXED, goals=GoalConfig(True, 3)),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_every_number_goes_to_the_entity_that_its_field_names(name):
    fields = make_fields(CONFIGS[name])
    sets = observation_sets(fields)
    vector = jnp.arange(2 * sets.size).reshape(2, sets.size)  # each number is its place
    parts = {k: np.asarray(part) for k, part in sets.split(vector).items()}
    wanted: dict[str, list] = {OWN: []}
    start = 0
    for field in fields:
        numbers = list(range(start, start + field.size))
        start += field.size
        if not field.group:
            wanted[OWN] += numbers
            continue
        entities = wanted.setdefault(field.group, [])
        if field.index == len(entities):
            entities.append([])
        entities[field.index] += numbers
    assert start == sets.size
    assert sets.own_size == len(wanted[OWN])
    assert set(parts) == set(wanted)
    for part, expected in wanted.items():
        for row in (0, 1):
            expected_row = np.array(expected) + row * sets.size
            np.testing.assert_array_equal(parts[part][row], expected_row)


def test_entities_are_present_where_their_mask_is_1():
    fields = make_fields(CONFIGS["dynamic"])
    sets = observation_sets(fields)
    assert [(part.group, part.count) for part in sets.sets] == [
        ("bay", 3),
        ("agent", 3),
        ("parked_car", 4),
    ]
    masks, vector, start = {}, np.full(sets.size, 0.7, np.float32), 0
    for field in fields:
        if field.is_mask:
            bit = len(masks) % 3 == 0
            masks[field.group, field.index] = bit
            vector[start] = bit
        start += field.size
    present = sets.present(sets.split(jnp.asarray(vector)))
    found = {
        (group, index): bool(bit)
        for group, bits in present.items()
        for index, bit in enumerate(bits)
    }
    assert found == masks
    assert 0 < sum(masks.values()) < len(masks)


def test_entities_without_a_mask_are_always_present():
    cars = [Field("car_x", 1, -1, 1, "", "car", index) for index in range(3)]
    sets = observation_sets([Field("speed", 1, -1, 1, ""), *cars])
    present = sets.present(sets.split(jnp.zeros((2, sets.size))))
    assert {group: bits.shape for group, bits in present.items()} == {
        part.group: (2, part.count) for part in sets.sets
    }
    assert jax.tree.all(jax.tree.map(lambda bits: bits.all(), present))

"""A field of the observation vector: a slice with a name, a range and a meaning.

Angles enter as cosine and sine; distances both far (divided by `FAR`) and near
(divided by `NEAR` and clipped), so that metres and centimetres are both visible. Where
a lot is larger than the range of a field, the field is clipped.
"""

import dataclasses
from collections.abc import Iterable
from typing import Literal

import jax
import jax.numpy as jnp

FAR = 20.0  # m, about half a `tanner` lot
# Where distances are cut off [FAR]: 160 m. By default lots of the families are up to
# 84 m across (`angled`).
FARTHEST = 8.0
NEAR = 3.0  # m, the last car length before the goal
CLOSE = 0.5  # m, about the room on either side of a car in its bay
LENGTH = 5.0  # m, about a car

# Entities that are observed several times over: other agents, parked cars, both in one
# list, and tracked bays.
Group = Literal["", "agent", "parked_car", "car", "bay"]
# Groups whose slots mean something: actions name tracked bays by their slots.
ORDERED: tuple[Group, ...] = ("bay",)


@dataclasses.dataclass(frozen=True)
class Field:
    """A named slice of the observation vector.

    Attributes:
        name: unique; starts with group and index if there are any.
        size: numbers it takes.
        low: smallest value.
        high: largest value; the ranges hold while cars stay on the lot and within
            their speed limits.
        meaning: what the numbers are, with scale and unit.
        group: the repeated entity it describes; "" if it describes none. All entities
            of a group have the same fields in the same order, next to each other.
        index: which of the group, from 0.
        is_mask: whether it is 1 where the entity is present, and 0 where it is not.
        metres: scale of a length [m], whose range holds on the lot only; else 0.
        speed: scale of a speed [m/s], or of a yaw rate [m/s per rad/s], whose range
            holds below the speeds of a car park only; else 0.
    """

    name: str
    size: int
    low: float
    high: float
    meaning: str
    group: Group = ""
    index: int = 0
    is_mask: bool = False
    metres: float = 0.0
    speed: float = 0.0


def far(distance: jax.Array) -> jax.Array:
    """Distances or coordinates (...) [m] in units of `FAR`, within `FARTHEST`."""
    return jnp.clip(distance / FAR, -FARTHEST, FARTHEST)


def repeated(group: Group, count: int, fields: Iterable[Field]) -> list[Field]:
    """The fields of the first `count` entities of a group, one after the other."""
    fields = tuple(fields)
    return [
        dataclasses.replace(
            field, name=f"{group}_{index}_{field.name}", group=group, index=index
        )
        for index in range(count)
        for field in fields
    ]


def repeated_values(group: Group, values: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """The values of entities (num_agents, count, k) by the names of their fields."""
    return {
        f"{group}_{index}_{name}": value[:, index]
        for name, value in values.items()
        for index in range(value.shape[1])
    }

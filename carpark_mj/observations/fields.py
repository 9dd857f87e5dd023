"""A field of the observation vector: a slice with a name, a range and a meaning.

Angles enter as cosine and sine; distances both far (divided by `FAR`) and near
(divided by `NEAR` and clipped), so that metres and centimetres are both visible. Where
a lot is larger than the range of a field, the field is clipped.
"""

import dataclasses
from collections.abc import Iterable

import jax
import jax.numpy as jnp

FAR = 20.0  # m, about half a `square` lot
# Where distances are cut off [FAR]: 160 m. By default lots of the families are up to
# 84 m across (`angled`).
FARTHEST = 8.0
NEAR = 3.0  # m, the last car length before the goal
CLOSE = 0.5  # m, about the room on either side of a car in its bay
LENGTH = 5.0  # m, about a car

# Groups whose slots mean something: actions name tracked bays by their slots.
ORDERED = ("bay",)


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
        group: the repeated entity it describes, as `agent`, `parked_car` or `bay`; ""
            if it describes none. All entities of a group have the same fields in the
            same order, next to each other.
        index: which of the group, from 0.
        is_mask: whether it is 1 where the entity is present, and 0 where it is not.
        metres: scale of a length [m], whose range holds on the lot only; else 0.
        speed: scale of a speed [m/s], or of a yaw rate [m/s per rad/s], whose range
            holds below the speeds of a car park only; else 0.
        is_whole: whether its numbers are whole, from `low` to `high`.
        reveals_goal: whether it tells an agent where its own goal is; goals that are
            relabelled (`carpark_mj.wrappers.goal`) would contradict it.
    """

    name: str
    size: int
    low: float
    high: float
    meaning: str
    group: str = ""
    index: int = 0
    is_mask: bool = False
    metres: float = 0.0
    speed: float = 0.0
    is_whole: bool = False
    reveals_goal: bool = False


def far(distance: jax.Array) -> jax.Array:
    """Distances or coordinates (...) [m] in units of `FAR`, within `FARTHEST`."""
    return jnp.clip(distance / FAR, -FARTHEST, FARTHEST)


def repeated(group: str, count: int, fields: Iterable[Field]) -> list[Field]:
    """The fields of the first `count` entities of a group, one after the other."""
    fields = tuple(fields)
    return [
        dataclasses.replace(
            field, name=f"{group}_{index}_{field.name}", group=group, index=index
        )
        for index in range(count)
        for field in fields
    ]


def repeated_values(group: str, values: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """The values of entities (num_agents, count, k) by the names of their fields."""
    return {
        f"{group}_{index}_{name}": value[:, index]
        for name, value in values.items()
        for index in range(value.shape[1])
    }

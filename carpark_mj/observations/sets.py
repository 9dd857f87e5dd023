"""The observation vector taken apart: own numbers, and sets of entities.

Networks that treat all cars of a set alike read it in this form, and need not know how
many slots there are.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.observations.fields import Field

OWN = "own"  # name of the part that describes no repeated entity


@dataclasses.dataclass(frozen=True)
class EntitySet:
    """Where a group of entities lies in the observation vector.

    Attributes:
        group: what they are.
        start: index of the first entity's first number.
        count: number of entities, absent ones included.
        size: numbers of an entity.
        mask: which of them says whether the entity is present; None = all always are.
    """

    group: str
    start: int
    count: int
    size: int
    mask: int | None


@dataclasses.dataclass(frozen=True)
class ObservationSets:
    """The parts of an observation vector.

    Attributes:
        size: of the vector.
        sets: the entities, in the vector's order.
    """

    size: int
    sets: tuple[EntitySet, ...] = ()

    @property
    def own_size(self) -> int:
        """Numbers that describe no repeated entity."""
        return self.size - sum(part.count * part.size for part in self.sets)

    def split(self, observation: jax.Array) -> dict[str, jax.Array]:
        """Takes vectors (..., size) apart.

        Returns:
            `OWN` (..., own_size), and by group (..., count, entity size).
        """
        lead, start = observation.shape[:-1], 0
        own: list[jax.Array] = []
        parts: dict[str, jax.Array] = {}
        for part in self.sets:
            own.append(observation[..., start : part.start])
            start = part.start + part.count * part.size
            entities = observation[..., part.start : start]
            parts[part.group] = entities.reshape(*lead, part.count, part.size)
        own.append(observation[..., start:])
        return {OWN: jnp.concatenate(own, axis=-1), **parts}

    def present(self, parts: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Whether the entities in parts are there, (..., count) bool by group."""
        found = {}
        for part in self.sets:
            entities = parts[part.group]
            if part.mask is None:
                found[part.group] = jnp.ones(entities.shape[:-1], bool)
            else:
                found[part.group] = entities[..., part.mask] > 0.5
        return found


def observation_sets(fields: Sequence[Field]) -> ObservationSets:
    """Finds the sets of entities in the declared fields of a vector, in order."""
    members: dict[str, list[tuple[int, Field]]] = {}
    position = 0
    for field in fields:
        if field.group:
            members.setdefault(field.group, []).append((position, field))
        position += field.size
    sets = [_entity_set(group, rows) for group, rows in members.items()]
    return ObservationSets(position, tuple(sets))


def _entity_set(group: str, rows: list[tuple[int, Field]]) -> EntitySet:
    start = rows[0][0]
    first = [(position, field) for position, field in rows if field.index == 0]
    masks = [position - start for position, field in first if field.is_mask]
    return EntitySet(
        group=group,
        start=start,
        count=1 + max(field.index for _, field in rows),
        size=sum(field.size for _, field in first),
        mask=masks[0] if masks else None,
    )

"""The observation vector taken apart: own numbers, sets of entities, and pictures.

Networks that treat all cars of a set alike read it in this form, and need not know how
many slots there are.
"""

import dataclasses
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from carpark_mj.observations.fields import Field

OWN = "own"  # name of the part that describes no repeated entity and is no picture


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
class PictureSet:
    """Where pictures of one shape lie in the observation vector: views in channels.

    Attributes:
        name: of the part.
        shape: (views, height, width) of every channel.
        starts: index of the first number of each channel.
        kinds: of each channel, how many kinds a pixel can show; 0 = it has a number.
    """

    name: str
    shape: tuple[int, int, int]
    starts: tuple[int, ...]
    kinds: tuple[int, ...]

    @property
    def channel_size(self) -> int:
        """Numbers of a channel."""
        return math.prod(self.shape)


@dataclasses.dataclass(frozen=True)
class ObservationSets:
    """The parts of an observation vector.

    Attributes:
        size: of the vector.
        sets: the entities, in the vector's order.
        pictures: by their shapes.
    """

    size: int
    sets: tuple[EntitySet, ...] = ()
    pictures: tuple[PictureSet, ...] = ()

    @property
    def own_size(self) -> int:
        """Numbers that describe no repeated entity and are in no picture."""
        return self.size - sum(stop - start for start, stop in self._others())

    def _others(self) -> list[tuple[int, int]]:
        """Where what is not the own numbers begins and ends, in the vector's order."""
        ends = [(x.start, x.start + x.count * x.size) for x in self.sets]
        for part in self.pictures:
            ends += [(start, start + part.channel_size) for start in part.starts]
        return sorted(ends)

    def split(self, observation: jax.Array) -> dict[str, jax.Array]:
        """Takes vectors (..., size) apart.

        Returns:
            `OWN` (..., own_size), by group (..., count, entity size), and by the names
            of pictures (..., views, height, width, channels).
        """
        lead, start = observation.shape[:-1], 0
        own: list[jax.Array] = []
        for begin, end in self._others():
            own.append(observation[..., start:begin])
            start = end
        own.append(observation[..., start:])
        parts = {OWN: jnp.concatenate(own, axis=-1)}
        for part in self.sets:
            entities = observation[
                ..., part.start : part.start + part.count * part.size
            ]
            parts[part.group] = entities.reshape(*lead, part.count, part.size)
        for part in self.pictures:
            channels = [
                observation[..., start : start + part.channel_size]
                for start in part.starts
            ]
            pictures = jnp.stack(channels, axis=-1)
            parts[part.name] = pictures.reshape(*lead, *part.shape, -1)
        return parts

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


def part_name(field: Field) -> str:
    """The part that a field belongs to: its group, the pictures of its shape, `OWN`."""
    if field.group or not is_picture(field):
        return field.group or OWN
    return "pictures_" + "x".join(map(str, field.shape))


def is_picture(field: Field) -> bool:
    """Whether a field is a picture (height, width), or one for each of some views."""
    return not field.group and len(field.shape) in (2, 3)


def observation_sets(fields: Sequence[Field]) -> ObservationSets:
    """Finds sets of entities and pictures in the declared fields of a vector."""
    members: dict[str, list[tuple[int, Field]]] = {}
    position = 0
    for field in fields:
        members.setdefault(part_name(field), []).append((position, field))
        position += field.size
    members.pop(OWN, None)
    sets, pictures = [], []
    for name, rows in members.items():
        if is_picture(rows[0][1]):
            pictures.append(_picture_set(name, rows))
        else:
            sets.append(_entity_set(name, rows))
    return ObservationSets(position, tuple(sets), tuple(pictures))


def _picture_set(name: str, rows: list[tuple[int, Field]]) -> PictureSet:
    *views, height, width = rows[0][1].shape
    whole = [field.is_whole and field.low == 0.0 for _, field in rows]
    return PictureSet(
        name=name,
        shape=(views[0] if views else 1, height, width),
        starts=tuple(position for position, _ in rows),
        kinds=tuple(
            int(field.high) + 1 if has_kinds else 0
            for (_, field), has_kinds in zip(rows, whole, strict=True)
        ),
    )


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

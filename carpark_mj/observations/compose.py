"""The observation vector of an environment: put together and taken apart."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from carpark_mj.observations.fields import Field
from carpark_mj.types import State

if TYPE_CHECKING:
    from carpark_mj.config import EnvConfig


VECTOR = "vector"  # name of what is no picture
BRIGHTEST = 255


def make_fields(config: EnvConfig) -> tuple[Field, ...]:
    """Lists the fields of the observation vector in order."""
    return tuple(config.observation.fields(config))


def observe(config: EnvConfig, state: State) -> jax.Array:
    """What agents observe (num_agents, size) float32; absent ones observe zeros."""
    vector = join(config, config.observation.values(config, state), state.goal.shape[0])
    if state.present is None:
        return vector
    return jnp.where(state.present[:, None], vector, 0.0)


def join(config: EnvConfig, values: Mapping[str, jax.Array], count: int) -> jax.Array:
    """The observations (count, observation_size) float32 of values by field."""
    fields = make_fields(config)
    shapes = {field.name: (count, field.size) for field in fields}
    given = {name: jnp.shape(value) for name, value in values.items()}
    wrong = {x for x, n in Counter(field.name for field in fields).items() if n > 1}
    wrong |= {x for x in shapes.keys() | given if shapes.get(x) != given.get(x)}
    if wrong:
        each = (f"{x}: {shapes.get(x)}, {given.get(x)}" for x in sorted(wrong))
        raise ValueError(
            f"the observation encoder {config.observation.encoding!r} must declare "
            f"each field once and fill it: its shapes and values' are {', '.join(each)}"
        )
    # XLA would compute the values within the concatenation, some of them repeatedly.
    # Those of entities are pieces of arrays behind a barrier, see `repeated_values`.
    own = {field.name: values[field.name] for field in fields if not field.group}
    ordered = {**values, **jax.lax.optimization_barrier(own)}
    columns = [ordered[field.name] for field in fields]
    return jnp.concatenate(columns, axis=-1).astype(jnp.float32)


def unpack(
    fields: Sequence[Field], observation: jax.Array
) -> jax.Array | dict[str, jax.Array]:
    """Takes the pictures out of observations (..., size), also under `jit` and `vmap`.

    Returns:
        `VECTOR` (..., numbers) float32 of all other fields, and each picture by its
        name, (..., *field.shape) uint8: over its range from 0 to `BRIGHTEST`, see
        `Field.gamma`. The observation itself if it has no pictures.
    """
    if not any(field.shape for field in fields):
        return observation
    rest, found, begin = [], {}, 0
    for field in fields:
        part = observation[..., begin : begin + field.size]
        begin += field.size
        if not field.shape:
            rest.append(part)
            continue
        share = (part - field.low) / (field.high - field.low)
        bright = jnp.round(BRIGHTEST * jnp.clip(share, 0.0, 1.0) ** field.gamma)
        picture = bright.astype(jnp.uint8)
        found[field.name] = picture.reshape(*picture.shape[:-1], *field.shape)
    return {VECTOR: jnp.concatenate(rest, axis=-1)} | found


def observation_size(config: EnvConfig) -> int:
    """Length of an agent's observation."""
    return sum(field.size for field in make_fields(config))


OWN = "own"  # name of the part that describes no repeated entity and is no picture


@dataclasses.dataclass(frozen=True)
class EntitySet:
    """Where a group of entities lies in the observation vector."""

    group: str  # what they are
    start: int  # index of the first entity's first number
    count: int  # of entities, absent ones included
    size: int  # numbers of an entity
    mask: int | None  # which of these marks present ones; None = all are present


@dataclasses.dataclass(frozen=True)
class PictureSet:
    """Where pictures of one shape lie in the observation vector: views in channels."""

    name: str  # of the part
    shape: tuple[int, int, int]  # (views, height, width) of every channel
    starts: tuple[int, ...]  # index of the first number of each channel
    kinds: tuple[int, ...]  # that a pixel can show, by channel; 0 = it has a number

    @property
    def channel_size(self) -> int:
        """Numbers of a channel."""
        return math.prod(self.shape)


@dataclasses.dataclass(frozen=True)
class ObservationSets:
    """The parts of an observation vector."""

    size: int  # of the vector
    sets: tuple[EntitySet, ...] = ()  # the entities, in the vector's order
    pictures: tuple[PictureSet, ...] = ()  # by their shapes

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
            end = part.start + part.count * part.size
            entities = observation[..., part.start : end]
            parts[part.group] = entities.reshape(*lead, part.count, part.size)
        for part in self.pictures:
            size = part.channel_size
            channels = [observation[..., start : start + size] for start in part.starts]
            pictures = jnp.stack(channels, axis=-1)
            parts[part.name] = pictures.reshape(*lead, *part.shape, -1)
        return parts

    def present(self, parts: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Whether the entities in parts are there, (..., count) bool by group."""
        found = {}
        for part in self.sets:
            numbers, mask = parts[part.group], part.mask
            if mask is None:
                found[part.group] = jnp.ones(numbers.shape[:-1], bool)
            else:
                found[part.group] = numbers[..., mask] > 0.5
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
    starts, fields = zip(*rows, strict=True)
    kinds = (int(x.high) + 1 if x.is_whole and x.low == 0.0 else 0 for x in fields)
    *views, height, width = fields[0].shape
    shape = views[0] if views else 1, height, width
    return PictureSet(name, shape, starts, tuple(kinds))


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

"""The observation vector of an environment: its encoder's values in declared order.

Adapters take the pictures out of it.
"""

from collections.abc import Iterable, Mapping, Sequence

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.observations.fields import Field
from carpark_mj.types import State

VECTOR = "vector"  # name of what is no picture
BRIGHTEST = 255


def make_fields(config: EnvConfig) -> tuple[Field, ...]:
    """Lists the fields of the observation vector in order.

    `observe`, the vector's size and the table in the documentation all read them.
    """
    return tuple(config.observation.fields(config))


def observe(config: EnvConfig, state: State) -> jax.Array:
    """What the agents of a lot observe, (num_agents, observation_size) float32.

    Absent agents observe zeros.

    Raises:
        ValueError: the encoder's values do not match its fields.
    """
    vector = join(config, config.observation.values(config, state), state.goal.shape[0])
    if state.present is None:
        return vector
    return jnp.where(state.present[:, None], vector, 0.0)


def join(config: EnvConfig, values: Mapping[str, jax.Array], count: int) -> jax.Array:
    """The observations (count, observation_size) float32 of values by field.

    Raises:
        ValueError: the values do not match the encoder's fields.
    """
    fields = make_fields(config)
    _require_fit(config.observation.encoding, fields, values, count)
    # XLA would compute the values within the concatenation, some of them repeatedly.
    ordered = jax.lax.optimization_barrier([values[field.name] for field in fields])
    return jnp.concatenate(ordered, axis=-1).astype(jnp.float32)


def _require_fit(
    encoding: str,
    fields: Sequence[Field],
    values: Mapping[str, jax.Array],
    num_agents: int,
) -> None:
    """Refuses values that do not match the fields, each (num_agents, size).

    Raises:
        ValueError: naming the encoder and the fields.
    """
    shapes = {field.name: (num_agents, field.size) for field in fields}
    given = {name: jnp.shape(value) for name, value in values.items()}
    if len(shapes) < len(fields):
        names = [field.name for field in fields]
        wrong = f"declares {sorted({x for x in names if names.count(x) > 1})} twice"
    elif missing := sorted(shapes.keys() - given.keys()):
        wrong = f"does not fill {missing}, which it declares"
    elif extra := sorted(given.keys() - shapes.keys()):
        wrong = f"fills {extra}, which it does not declare"
    elif bad := sorted(name for name in shapes if given[name] != shapes[name]):
        wrong = (
            f"fills {bad} with {[given[name] for name in bad]} numbers but declares "
            f"{[shapes[name] for name in bad]}"
        )
    else:
        return
    raise ValueError(f"the observation encoder {encoding!r} {wrong}")


def unpack(
    fields: Sequence[Field], observation: jax.Array
) -> jax.Array | dict[str, jax.Array]:
    """Takes the pictures out of observations, also under `jit`, `vmap` and in parts.

    Args:
        fields: of the observation, static.
        observation: (..., size) float32.

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


def cardinalities(config: EnvConfig) -> tuple[int, ...]:
    """How many values each number of the observation can have, for tables.

    Raises:
        ValueError: a number is not whole, or its range does not begin at 0.
    """
    fields = make_fields(config)
    if not all(field.is_whole and field.low == 0 for field in fields):
        raise ValueError(
            "a table needs an observation of whole numbers, not the encoding "
            f"{config.observation.encoding!r}"
        )
    return tuple(int(field.high) + 1 for field in fields for _ in range(field.size))


def markdown_table(fields: Iterable[Field]) -> str:
    """Fields as a markdown table; of repeated entities the first."""
    rows = ["| field | size | range | meaning [unit] |", "|---|---|---|---|"]
    rows += [
        f"| `{field.name}` | {field.size} | {field.low:g} … {field.high:g} | "
        f"{field.meaning} |"
        for field in fields
        if field.index == 0
    ]
    return "\n".join(rows)

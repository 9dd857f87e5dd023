"""Networks of a set encoder taken over by agents that observe more.

Weights of new fields begin at zero, so that the networks act as they did; their running
statistics begin at mean 0 and standard deviation 1, for observations are of order 1.
"""

import dataclasses
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.observations import make_fields
from carpark_mj.observations.fields import Field
from carpark_mj.observations.rays import RAYS
from carpark_mj.observations.sets import part_name
from carpark_mj.training.ppo.config import PPOConfig


def new_fields(config: PPOConfig, env: EnvConfig) -> list[str]:
    """Fields of which agents of a training observe more than those in `env`.

    Raises:
        ValueError: those in `env` observe others besides, or no set encoder reads them,
            or they are of another kind of entities.
    """
    ours, theirs = (
        {
            (number, _without_count(field)): field
            for field in make_fields(each)
            if field.index == 0
            for number in _numbers(field)
        }
        for each in (config.env, env)
    )
    added = sorted({ours[number].name for number in ours.keys() - theirs.keys()})
    if not added:
        return []
    if config.networks.encoder != "set":
        raise ValueError(
            f"{config.warm_start} was trained without {', '.join(added)}; only a set "
            "encoder takes more observations"
        )
    lost = sorted({theirs[number].name for number in theirs.keys() - ours.keys()})
    if lost:
        raise ValueError(
            f"{config.warm_start} was trained on other observations: {', '.join(lost)}"
        )
    # A new kind would change what the layers behind the encoder read.
    kinds = {part_name(f) for f in ours.values()} - {
        part_name(f) for f in theirs.values()
    }
    if kinds:
        raise ValueError(
            f"{config.warm_start} was trained without entities of the kind "
            f"{', '.join(sorted(kinds))}; only more numbers of its own kinds fit"
        )
    return added


def widen(config: PPOConfig, env: EnvConfig, taken: dict[str, Any]) -> dict[str, Any]:
    """Normalizer and networks of a run in `env`, for agents that observe more.

    Args:
        config: of the training that takes them over.
        env: in which agents observe less, see `new_fields`.
        taken: `normalizer`, and networks by name.
    """
    ours, theirs = _places(config.env), _places(env)
    rows = {
        part: (len(names), np.array([names.index(name) for name in theirs[part]]))
        for part, names in ours.items()
    }
    normalizer = {
        part: _widen_statistics(state, *rows[part])
        for part, state in taken["normalizer"].items()
    }

    def widen_layer(path: Any, weights: jax.Array) -> jax.Array:
        layer, kind = (str(key.key) for key in path[-2:])
        part = layer.removesuffix("_0")  # the layer that reads the part
        if kind != "kernel" or part not in rows:
            return weights
        return _spread(weights, 0.0, *rows[part])

    networks = {name: tree for name, tree in taken.items() if name != "normalizer"}
    networks = jax.tree_util.tree_map_with_path(widen_layer, networks)
    return {"normalizer": normalizer, **networks}


def _places(env: EnvConfig) -> dict[str, list[str]]:
    """Names of the numbers that networks read as a part, in order, by part."""
    names: dict[str, list[str]] = {}
    for field in make_fields(env):
        if field.index == 0:
            names.setdefault(part_name(field), []).extend(_numbers(field))
    return names


def _numbers(field: Field) -> list[str]:
    """Names of a field's numbers: of rays by bearing, so that 24 are among 72."""
    size = field.size
    if field.name == RAYS:
        return [f"{RAYS} {Fraction(k, size)} of a turn" for k in range(size)]
    return [f"{field.name} {k}" for k in range(size)]


def _without_count(field: Field) -> Field:
    """The field, but for how many rays there are."""
    return dataclasses.replace(field, size=0) if field.name == RAYS else field


def _spread(
    values: jax.Array, fill: jax.Array | float, size: int, rows: np.ndarray
) -> jax.Array:
    """The values as `rows` of an array (size, ...), `fill` elsewhere."""
    whole = jnp.full((size, *values.shape[1:]), fill, values.dtype)
    return whole.at[rows].set(values)


def _widen_statistics(state: Any, size: int, rows: np.ndarray) -> Any:
    """Brax's running statistics of `size` numbers, mean 0 and variance 1 if new."""
    count = jnp.float32(state.count.hi) * 2.0**32 + jnp.float32(state.count.lo)
    return state.replace(
        mean=_spread(state.mean, 0.0, size, rows),
        std=_spread(state.std, 1.0, size, rows),
        summed_variance=_spread(state.summed_variance, count, size, rows),
    )

"""Networks of a set encoder taken over by agents that observe more.

Weights of new fields begin at zero, so that the networks act as they did; their running
statistics begin at mean 0 and standard deviation 1, for observations are of order 1.
Entities of a new kind have layers and statistics of their own, as of a new run; what
reads their features begins at zero.
"""

import dataclasses
from fractions import Fraction
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.observations import make_fields
from carpark_mj.observations.compose import OWN, observation_sets, part_name
from carpark_mj.observations.fields import ORDERED, Field
from carpark_mj.observations.ranges import RAYS, RAYS_NEAR
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.config import PPOConfig

HIDDEN = "hidden"  # of `hidden_0`, the first layer behind the encoder
_BY_BEARING = (RAYS, RAYS_NEAR)  # fields whose numbers have bearings


def new_fields(config: PPOConfig, env: EnvConfig) -> list[str]:
    """Fields of which agents of a training observe more than those in `env`.

    Raises:
        ValueError: those in `env` observe others besides, or no set encoder reads them.
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
    return added


def widen(
    config: PPOConfig, env: EnvConfig, taken: dict[str, Any], new: dict[str, Any]
) -> dict[str, Any]:
    """Normalizer and networks of a run in `env`, for agents that observe more.

    Args:
        config: of the training that takes them over.
        env: in which agents observe less, see `new_fields`.
        taken: `normalizer`, and networks by name.
        new: the same of a training that takes nothing over.
    """
    ours, theirs = (_places(config.networks, each) for each in (config.env, env))
    rows = {
        part: (len(ours[part]), np.array([ours[part].index(name) for name in names]))
        for part, names in theirs.items()
    }
    normalizer = new["normalizer"] | {
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
    networks = {name: _over(tree, new[name]) for name, tree in networks.items()}
    return {"normalizer": normalizer, **networks}


def _over(tree: Any, under: Any) -> Any:
    """A tree of dictionaries, and what only the other has."""
    if not isinstance(tree, dict):
        return tree
    return under | {name: _over(part, under[name]) for name, part in tree.items()}


def _places(networks: NetworkConfig, env: EnvConfig) -> dict[str, list[str]]:
    """Names of the numbers that networks read as a part, in order, by part.

    `HIDDEN` is what the layers behind the encoder read.
    """
    names: dict[str, list[str]] = {}
    fields = make_fields(env)
    for field in fields:
        if field.index == 0:
            names.setdefault(part_name(field), []).extend(_numbers(field))
    sizes, inputs = {OWN: networks.own_size}, observation_sets(fields)
    for part in inputs.sets:
        count = part.count if part.group in ORDERED else 1
        sizes[part.group] = count * networks.entity_size
    for part in inputs.pictures:
        sizes[part.name] = part.shape[0] * networks.picture_size
    behind = [f"{part} {k}" for part, size in sizes.items() for k in range(size)]
    return names | {HIDDEN: behind}


def _numbers(field: Field) -> list[str]:
    """Names of a field's numbers: of rays by bearing, so that 24 are among 72."""
    size = field.size
    if field.name in _BY_BEARING:
        return [f"{field.name} {Fraction(k, size)} of a turn" for k in range(size)]
    return [f"{field.name} {k}" for k in range(size)]


def _without_count(field: Field) -> Field:
    """The field, but for how many rays there are."""
    return dataclasses.replace(field, size=0) if field.name in _BY_BEARING else field


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

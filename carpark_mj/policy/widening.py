"""Networks whose agents observe more.

Weights of new fields begin at zero, so that the networks act as they did; their running
statistics begin at mean 0 and standard deviation 1, for observations are of order 1.
Entities of a new kind, and more features of the agent's own numbers, begin as of a new
run; what reads them begins at zero.
"""

from dataclasses import replace
from fractions import Fraction
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.observations import make_fields
from carpark_mj.observations.compose import OWN, observation_sets, part_name
from carpark_mj.observations.fields import ORDERED, Field
from carpark_mj.observations.ranges import RAYS, RAYS_NEAR

HIDDEN = "hidden"  # of `hidden_0`, the first layer behind the encoder
_BY_BEARING = (RAYS, RAYS_NEAR)  # fields whose numbers have bearings


class Trained(NamedTuple):
    """What was trained."""

    run: str
    networks: NetworkConfig
    env: EnvConfig


def new_fields(env: EnvConfig, trained: Trained) -> list[str]:
    """Fields of which agents in `env` observe more than those that were trained.

    `ValueError` where they observe less, or their encoder takes no more.
    """
    # Of rays the numbers count, not how many there are.
    ours, theirs = (
        {
            (number, replace(field, size=0) if field.name in _BY_BEARING else field)
            for field in make_fields(each)
            if field.index == 0
            for number in _numbers(field)
        }
        for each in (env, trained.env)
    )
    added, lost = (
        sorted({field.name for _, field in more})
        for more in (ours - theirs, theirs - ours)
    )
    if lost:
        raise ValueError(
            f"{trained.run} was trained on other observations: {', '.join(lost)}"
        )
    if added and trained.networks.encoder != "set":
        raise ValueError(
            f"{trained.run} was trained without {', '.join(added)}; only a set "
            "encoder takes more observations"
        )
    return added


def widen(
    networks: NetworkConfig,
    env: EnvConfig,
    trained: Trained,
    taken: dict[str, Any],
    new: dict[str, Any],
) -> dict[str, Any]:
    """Normalizer and networks that were trained, as larger `networks` in `env`.

    Its agents may observe more, and have more `own_size`. `taken` are the `normalizer`
    and networks by name, and `new` the same of `networks` that take nothing over.
    """
    if networks.encoder != "set":  # without parts, and none of them may grow
        return taken
    ours, theirs = _places(networks, env), _places(trained.networks, trained.env)
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

    found = {name: tree for name, tree in taken.items() if name != "normalizer"}
    found = jax.tree_util.tree_map_with_path(widen_layer, found)
    found = {name: _over(tree, new[name]) for name, tree in found.items()}
    return {"normalizer": normalizer, **found}


def _over(tree: Any, under: Any) -> Any:
    """A tree of dictionaries, and what only the other has: names, later columns."""
    if isinstance(tree, dict):
        return under | {name: _over(part, under[name]) for name, part in tree.items()}
    return jnp.asarray(under).at[..., : tree.shape[-1]].set(tree)


def _places(networks: NetworkConfig, env: EnvConfig) -> dict[str, list[str]]:
    """Names of the numbers that networks read as a part, in order, by part."""
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


def _spread(values: jax.Array, fill: Any, size: int, rows: np.ndarray) -> jax.Array:
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

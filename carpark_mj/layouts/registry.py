"""Layouts by name, file or config, and which lots are for training.

Random lots are numbered from 0 to 2^32 - 1, and lot n is drawn from
`fold_in(key(0), n)`. Training draws from the lower half of the numbers, evaluation from
the upper half. Threefry, JAX's generator, is a block cipher: for a given key no two
numbers fold to equal keys, so that no lot of one half is drawn in the other.
"""

import abc
from collections.abc import Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import require_choice, require_kind
from carpark_mj.layouts.base import FAMILIES, LAYOUTS, LayoutConfig, layout_format
from carpark_mj.layouts.types import Layout

# Jitted: many small operations would each be compiled on their own.
_compiled = jax.jit(lambda config, key: config.generate(key), static_argnums=0)
Split = Literal["train", "test"]
TRAIN = range(2**31)
TEST = range(2**31, 2**32)


class FixedLayoutConfig(LayoutConfig):
    """A config with one lot, its property `layout`."""

    is_random = False
    is_enclosed = False  # walls need not enclose the ground

    @property
    @abc.abstractmethod
    def layout(self) -> Layout:
        """The lot, as numpy arrays."""

    @property
    def min_bays(self) -> int:
        """Its bays."""
        return int(self.layout.bay_mask.sum())

    @property
    def min_goals(self) -> int:
        """Its bays that are not reserved for parked cars."""
        return int(self.layout.goal_mask.sum())

    def generate(self, key: jax.Array) -> Layout:
        """The lot; the key is unused."""
        del key
        return jax.tree.map(jnp.asarray, self.layout)


def layout_config(layout: LayoutConfig | str) -> LayoutConfig:
    """The config of a name, of a layout file, or of several with commas: a mixture.

    A config is returned as it is.

    Raises:
        ValueError: unknown name (the message lists the known ones), or a bad file.
        TypeError: another type.
    """
    require_kind("layout", layout, LayoutConfig | str)
    if isinstance(layout, LayoutConfig):
        return layout
    if "," in layout:
        return mixture(layout.split(","))
    if layout_format(layout):
        family: Any = FAMILIES["from_file"]
        return family(path=layout)
    return LAYOUTS[layout]


def member_shares(config: LayoutConfig) -> dict[str, float]:
    """The members of a mixture by name, with their shares of the lots.

    A config that is no mixture is its own only member. Members have the names that they
    are registered under, or else that of their family; a repeated one gets a number.
    """
    shares: dict[str, float] = {}
    for member, share in config.shares:
        lots = getattr(member, "lots", member)  # whose name changed ones have, too
        name = LAYOUTS.name_of(member) or LAYOUTS.name_of(lots) or member.family
        first, number = name, 2
        while name in shares:
            name, number = f"{first} {number}", number + 1
        shares[name] = share
    return shares


def make_layout(layout: LayoutConfig | str, key: jax.Array | None = None) -> Layout:
    """Draws a lot of a layout, see `layout_config`; with `key(0)` if it is None."""
    key = jax.random.key(0) if key is None else key
    return _compiled(layout_config(layout), key)


def mixture(
    members: Sequence[LayoutConfig | str], weights: Sequence[float] = ()
) -> LayoutConfig:
    """A mixture of names, files or configs; see `MixtureConfig` and `layout_config`."""
    require_kind("members", members, list | tuple)
    family: Any = FAMILIES["mixture"]
    return family(tuple(map(layout_config, members)), tuple(weights))


def lot_number(split: Split, key: jax.Array) -> jax.Array:
    """Draws the number of a lot, uint32 (), uniform over a split."""
    require_choice("split", split, Split)
    first = TRAIN.start if split == "train" else TEST.start
    return jnp.uint32(first) + (jax.random.bits(key, (), jnp.uint32) >> 1)


def lot_key(number: jax.Array | int) -> jax.Array:
    """The key that lot `number` is drawn from."""
    return jax.random.fold_in(jax.random.key(0, impl="threefry2x32"), number)

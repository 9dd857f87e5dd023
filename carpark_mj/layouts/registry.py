"""Layouts by name, file or config, mixtures, and which lots are for training.

Random lots are numbered from 0 to 2^32 - 1, and lot n is drawn from
`fold_in(key(0), n)`. Training draws from the lower half of the numbers, evaluation from
the upper half. Threefry, JAX's generator, is a block cipher: for a given key no two
numbers fold to equal keys, so that no lot of one half is drawn in the other.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Bounds, require_choice, require_kind
from carpark_mj.layouts.base import (
    FAMILIES,
    LAYOUTS,
    LayoutConfig,
    layout_format,
    register_layout,
)
from carpark_mj.layouts.lot import AngledConfig
from carpark_mj.layouts.schematics import (
    SQUARE_COMPACT,
    StreetConfig,
    StreetParallelConfig,
)
from carpark_mj.layouts.standards import Entry
from carpark_mj.layouts.types import Layout, layout_maxima, pad_layout

# Jitted: many small operations would each be compiled on their own.
_compiled = jax.jit(lambda config, key: config.generate(key), static_argnums=0)
Split = Literal["train", "test"]
TRAIN = range(2**31)
TEST = range(2**31, 2**32)


@dataclasses.dataclass(frozen=True)
class MixtureConfig(LayoutConfig):
    """A mixture: every key draws a family first, then one of its lots.

    All its lots are padded to the same numbers of rows, so that a batch may hold lots
    of different families, and all keys share one compiled program.

    Attributes:
        members: configs of the families.
        weights: how often each is drawn, in proportion; empty = equally often.
    """

    members: tuple[LayoutConfig, ...] = (
        SQUARE_COMPACT,
        StreetConfig(),
        StreetParallelConfig(),
        AngledConfig(),
    )
    weights: Annotated[tuple[float, ...], Bounds(gt=0.0)] = ()
    family: str = "mixture"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.members:
            raise ValueError("members of a mixture must be one config or more, not ()")
        if self.weights and len(self.weights) != len(self.members):
            raise ValueError(
                f"weights must be one for each of the {len(self.members)} members, "
                f"not {self.weights}"
            )

    @property
    def parts(self) -> tuple[LayoutConfig, ...]:
        """The members, and the members of mixtures among them."""
        return sum((member.parts for member in self.members), ())

    @property
    def shares(self) -> tuple[tuple[LayoutConfig, float], ...]:
        """The members, each with its share of the lots."""
        total, pairs = sum(self._weights), zip(self.members, self._weights, strict=True)
        return tuple((member, weight / total) for member, weight in pairs)

    @property
    def _weights(self) -> tuple[float, ...]:
        return self.weights or (1.0,) * len(self.members)

    @property
    def is_enclosed(self) -> bool:
        """Whether walls keep cars within all of its lots."""
        return all(member.is_enclosed for member in self.members)

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return min(member.min_bays for member in self.members)

    @property
    def min_goals(self) -> int:
        """The fewest bays for goals that any key gives."""
        return min(member.min_goals for member in self.members)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Of all members; not known if one does not know."""
        entries = [member.entries for member in self.members]
        return sum(entries, ()) if all(entries) else ()

    def generate(self, key: jax.Array) -> Layout:
        """Draws a family, then a lot of it."""
        weights = jnp.array(self._weights, jnp.float32)
        pick_key, lot_key = jax.random.split(key)
        pick = jax.random.categorical(pick_key, jnp.log(weights))
        return self.generate_member(pick, lot_key)

    def generate_member(self, member: jax.Array, key: jax.Array) -> Layout:
        """Draws a lot of one member, () int32, padded like all lots of the mixture."""
        draws = [jax.jit(config.generate) for config in self.members]  # traced once
        maxima = layout_maxima(jax.eval_shape(draw, key) for draw in draws)
        padded = [
            lambda key, draw=draw: pad_layout(draw(key), maxima) for draw in draws
        ]
        return jax.lax.switch(member, padded, key)


class FixedLayoutConfig(LayoutConfig):
    """A config with one lot, its property `layout`."""

    @property
    @abc.abstractmethod
    def layout(self) -> Layout:
        """The lot, as numpy arrays."""

    @property
    def is_random(self) -> bool:
        """False: the lot does not depend on the key."""
        return False

    @property
    def is_enclosed(self) -> bool:
        """False: walls need not enclose the ground."""
        return False

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
    configs = tuple(layout_config(member) for member in members)
    return MixtureConfig(configs, tuple(weights))


def lot_number(split: Split, key: jax.Array) -> jax.Array:
    """Draws the number of a lot, uint32 (), uniform over a split."""
    require_choice("split", split, Split)
    first = TRAIN.start if split == "train" else TEST.start
    return jnp.uint32(first) + (jax.random.bits(key, (), jnp.uint32) >> 1)


def lot_key(number: jax.Array | int) -> jax.Array:
    """The key that lot `number` is drawn from."""
    return jax.random.fold_in(jax.random.key(0, impl="threefry2x32"), number)


register_layout("mixture", MixtureConfig())

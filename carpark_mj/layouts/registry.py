"""Families of lots by name, and the layouts of names and configs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import LAYOUT_FILES, LayoutConfig, require_layout
from carpark_mj.config.checks import require_kind
from carpark_mj.layouts.angled import AngledConfig, angled
from carpark_mj.layouts.dead_end import DeadEndConfig, dead_end
from carpark_mj.layouts.from_file import FromFileConfig, from_file
from carpark_mj.layouts.garage_row import GarageRowConfig, garage_row
from carpark_mj.layouts.hope import HOPE, HopeConfig, hope
from carpark_mj.layouts.lot import lot
from carpark_mj.layouts.lot_config import LotConfig
from carpark_mj.layouts.metadrive import MetaDriveConfig, metadrive
from carpark_mj.layouts.mixture import MixtureConfig
from carpark_mj.layouts.slots import SLOTS, SlotsConfig, slots
from carpark_mj.layouts.square import COMPACT, TANNER, SquareConfig, square
from carpark_mj.layouts.street import StreetConfig, StreetParallelConfig, street
from carpark_mj.layouts.tpcap_cases import TPCAP, TpcapConfig, tpcap
from carpark_mj.layouts.types import Layout, layout_maxima, pad_layout


class Family(NamedTuple):
    """A kind of lot.

    Attributes:
        config: its settings.
        generate: `(config, key) -> Layout`, always of the same shape for a config.
    """

    config: type[LayoutConfig]
    generate: Callable[[Any, jax.Array], Layout]


def draw_mixture(config: MixtureConfig, key: jax.Array) -> Layout:
    """Draws a family, then a lot of it."""
    weights = jnp.array(config.weights or (1.0,) * len(config.members), jnp.float32)
    pick_key, lot_key = jax.random.split(key)
    pick = jax.random.categorical(pick_key, jnp.log(weights))
    return draw_member(config, pick, lot_key)


def draw_member(config: MixtureConfig, member: jax.Array, key: jax.Array) -> Layout:
    """Draws a lot of one member, () int32, padded like all lots of the mixture."""

    def branch(member: LayoutConfig):
        return lambda key: generate(member, key)

    branches = [branch(member) for member in config.members]
    maxima = layout_maxima(jax.eval_shape(make, key) for make in branches)
    padded = [lambda key, make=make: pad_layout(make(key), maxima) for make in branches]
    return jax.lax.switch(member, padded, key)


FAMILIES: dict[str, Family] = {
    "square": Family(SquareConfig, square),
    "street": Family(StreetConfig, street),
    "street_parallel": Family(StreetParallelConfig, street),
    "angled": Family(AngledConfig, angled),
    "lot": Family(LotConfig, lot),
    "garage_row": Family(GarageRowConfig, garage_row),
    "dead_end": Family(DeadEndConfig, dead_end),
    "slots": Family(SlotsConfig, slots),
    "hope": Family(HopeConfig, hope),
    "metadrive": Family(MetaDriveConfig, metadrive),
    "tpcap": Family(TpcapConfig, tpcap),
    "from_file": Family(FromFileConfig, from_file),
    "mixture": Family(MixtureConfig, draw_mixture),
}

SQUARES: dict[str, SquareConfig] = {"tanner": TANNER, "compact": COMPACT}
# Configs with a name of their own, besides the defaults of the families.
NAMED: dict[str, LayoutConfig] = {**SQUARES, **SLOTS, **HOPE, **TPCAP}


def layout_config(layout: LayoutConfig | str) -> LayoutConfig:
    """The config that a layout's name stands for; a config stands for itself.

    Args:
        layout: a name, a layout file (.json or .csv), several of them separated by
            commas for their mixture, or a config.

    Raises:
        ValueError: unknown name, the message lists the known ones; or a bad file.
        TypeError: something else.
    """
    require_kind("layout", layout, LayoutConfig | str)
    if isinstance(layout, LayoutConfig):
        return layout
    if "," in layout:
        return mixture(layout.split(","))
    if layout.endswith(LAYOUT_FILES):
        return FromFileConfig(path=layout)
    if layout in NAMED:
        return NAMED[layout]
    require_layout(layout)
    return FAMILIES[layout].config()


def generate(config: LayoutConfig, key: jax.Array) -> Layout:
    """Draws a lot: the same key gives the same lot, other keys the same shapes."""
    return FAMILIES[config.family].generate(config, key)


def generate_member(
    config: LayoutConfig, member: jax.Array | None, key: jax.Array
) -> Layout:
    """Draws a lot of one member, () int32, of a mixture.

    Any lot of the mixture if it is None, and any lot of a config that is no mixture.
    """
    if isinstance(config, MixtureConfig) and member is not None:
        return draw_member(config, member, key)
    return generate(config, key)


def member_shares(config: LayoutConfig) -> dict[str, float]:
    """The members of a mixture by name, with their shares of the lots.

    A config that is no mixture is its own only member. Members are named after their
    family, or as `NAMED` has them; a repeated name gets a number.
    """
    if not isinstance(config, MixtureConfig):
        return {_name(config): 1.0}
    weights = config.weights or (1.0,) * len(config.members)
    shares: dict[str, float] = {}
    for member, weight in zip(config.members, weights, strict=True):
        name, number = _name(member), 2
        while name in shares:
            name, number = f"{_name(member)} {number}", number + 1
        shares[name] = weight / sum(weights)
    return shares


def _name(config: LayoutConfig) -> str:
    names = [name for name, known in NAMED.items() if known == config]
    return names[0] if names else config.family


# Jitted: many small operations would each be compiled on their own.
_compiled = jax.jit(generate, static_argnums=0)


def make_layout(layout: LayoutConfig | str, key: jax.Array | None = None) -> Layout:
    """Builds a layout from a name, a file or a config.

    Args:
        layout: see `layout_config`.
        key: of the lot; `jax.random.key(0)` if None.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    key = jax.random.key(0) if key is None else key
    return _compiled(layout_config(layout), key)


def mixture(
    members: Sequence[LayoutConfig | str], weights: Sequence[float] = ()
) -> MixtureConfig:
    """A mixture of layouts, each a name, a file or a config.

    Args:
        members: what to mix.
        weights: how often each is drawn, in proportion; empty = equally often.

    Raises:
        ValueError: unknown names, or weights that do not fit.
        TypeError: no list.
    """
    require_kind("members", members, list | tuple)
    configs = tuple(layout_config(member) for member in members)
    return MixtureConfig(members=configs, weights=tuple(weights))

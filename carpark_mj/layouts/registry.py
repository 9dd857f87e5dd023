"""Layouts by name, file or config."""

from collections.abc import Sequence
from typing import Any

import jax

from carpark_mj.config import LAYOUTS, LayoutConfig
from carpark_mj.config.checks import require_kind
from carpark_mj.config.layouts import FAMILIES, layout_format
from carpark_mj.layouts.types import Layout


def layout_config(layout: LayoutConfig | str) -> LayoutConfig:
    """The config of a layout given by name, by file or as a config.

    Args:
        layout: a name, a layout file, several of them separated by commas for their
            mixture, or a config.

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
        name, number = _name(member), 2
        while name in shares:
            name, number = f"{_name(member)} {number}", number + 1
        shares[name] = share
    return shares


def _name(config: LayoutConfig) -> str:
    return LAYOUTS.name_of(config) or config.family


# Jitted: many small operations would each be compiled on their own.
_compiled = jax.jit(lambda config, key: config.generate(key), static_argnums=0)


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
) -> LayoutConfig:
    """A mixture of layouts, each a name, a file or a config.

    Args:
        members: what to mix.
        weights: how often each is drawn, in proportion; empty = equally often.

    Raises:
        ValueError: unknown names, or weights that do not fit.
        TypeError: `members` is not a list.
    """
    require_kind("members", members, list | tuple)
    configs = tuple(layout_config(member) for member in members)
    family: Any = FAMILIES["mixture"]
    return family(members=configs, weights=tuple(weights))

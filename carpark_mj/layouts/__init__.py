"""Layouts of lots and the generators that make them."""

import jax

from carpark_mj.layouts.square import COMPACT, TANNER, SquareConfig, square
from carpark_mj.layouts.types import Layout, pad

SQUARES: dict[str, SquareConfig] = {"tanner": TANNER, "compact": COMPACT}


def make_layout(name: str, key: jax.Array | None = None) -> Layout:
    """Builds a named layout.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    if name not in SQUARES:
        raise ValueError(f"unknown layout {name!r}; choose from {sorted(SQUARES)}")
    return square(SQUARES[name], key)


__all__ = [
    "COMPACT",
    "SQUARES",
    "TANNER",
    "Layout",
    "SquareConfig",
    "make_layout",
    "pad",
    "square",
]

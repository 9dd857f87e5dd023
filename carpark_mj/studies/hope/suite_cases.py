"""The cases of the suite: the held-out ones of HOPE's levels, and TPCAP's."""

from typing import Literal, NamedTuple, get_args

import jax
import numpy as np

from carpark_mj.layouts import Layout, layout_maxima, pad_layout
from carpark_mj.layouts.standards import Level
from carpark_mj.studies.hope import held_out, moving_car
from carpark_mj.studies.tpcap import layouts as tpcap

SuiteLevel = Literal[Level, "tpcap"]
LEVELS: tuple[SuiteLevel, ...] = get_args(SuiteLevel)
TPCAP_LEVEL = "tpcap"


class Cases(NamedTuple):
    """Some cases of a level.

    Attributes:
        level: its name.
        number: (n,) which of the level's.
        kind: (n,) str, `parallel`, `perpendicular`, or `published` of TPCAP's.
        layouts: (n, ...) of the same shapes in all of HOPE's levels.
    """

    level: SuiteLevel
    number: np.ndarray
    kind: np.ndarray
    layouts: Layout


def case_numbers(level: SuiteLevel) -> range:
    """The numbers of a level's cases: of HOPE's from 0, TPCAP's as published."""
    return tpcap.NUMBERS if level == TPCAP_LEVEL else range(held_out.CASES)


def fingerprint(level: SuiteLevel) -> str:
    """The first digits of the SHA-256 of the data of a level's cases."""
    return (tpcap if level == TPCAP_LEVEL else held_out).SHA256[:16]


def require_aisle(level: SuiteLevel) -> None:
    """Refuses a moving car in TPCAP's cases.

    Raises:
        ValueError: it has no aisle to drive through.
    """
    if level == TPCAP_LEVEL:
        raise ValueError(
            f"moving_car needs an aisle; the cases of level {level} have none"
        )


def pick_cases(
    level: SuiteLevel, count: int, first: int = 0, with_moving_car: bool = False
) -> Cases:
    """Cases of a level that follow each other, with a moving car or without.

    Args:
        level: whose.
        count: how many.
        first: how many of the level's are left out before them.
        with_moving_car: of HOPE's levels only.

    Raises:
        ValueError: a moving car in TPCAP's cases, which have no aisle.
    """
    if with_moving_car:
        require_aisle(level)
    which = slice(first, first + count)
    number = np.array(case_numbers(level)[which])
    if level == TPCAP_LEVEL:
        layouts = jax.tree.map(lambda x: x[which], tpcap.load_tpcap())
        return Cases(level, number, np.full(len(number), "published"), layouts)
    layouts, parallel = held_out.load_held_out(level)
    shapes = [held_out.load_held_out(name).layouts for name in held_out.LEVELS]
    maxima, parallel = layout_maxima(shapes), parallel[which]
    padded = jax.vmap(lambda layout: pad_layout(layout, maxima))(
        jax.tree.map(lambda x: x[which], layouts)
    )
    if with_moving_car:
        padded = moving_car.add_ends(level, number, parallel, padded)
    kind = np.where(parallel, "parallel", "perpendicular")
    return Cases(level, number, kind, padded)

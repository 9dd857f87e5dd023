"""The cases of the suite: HOPE's levels, TPCAP's, and those of other packages."""

from collections.abc import Iterable
from typing import Literal, get_args

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import layout_maxima, pad_layout
from carpark_mj.layouts.standards import Level
from carpark_mj.studies.hope import held_out, moving_car
from carpark_mj.studies.hope.suite_levels import EXTRA_LEVELS, Cases
from carpark_mj.studies.tpcap import layouts as tpcap

LEVELS: tuple[str, ...] = get_args(Literal[Level, "tpcap"])  # driven by default
TPCAP_LEVEL = "tpcap"


def case_numbers(level: str) -> range:
    """The numbers of a level's cases: of HOPE's from 0, TPCAP's as published.

    Raises:
        ValueError: unknown level.
    """
    if level not in LEVELS:
        require_level(level)
        return EXTRA_LEVELS[level].numbers
    return tpcap.NUMBERS if level == TPCAP_LEVEL else range(held_out.CASES)


def fingerprint(level: str) -> str:
    """The first digits of the SHA-256 of the data of a level's cases."""
    if level not in LEVELS:
        return EXTRA_LEVELS[level].sha256[:16]
    return (tpcap if level == TPCAP_LEVEL else held_out).SHA256[:16]


def require_aisle(level: str) -> None:
    """Refuses a moving car in levels other than HOPE's.

    Raises:
        ValueError: it has no aisle to drive through, or other movers.
    """
    if level == TPCAP_LEVEL:
        raise ValueError(
            f"moving_car needs an aisle; the cases of level {level} have none"
        )
    if level not in LEVELS:
        raise ValueError(f"moving_car drives in HOPE's levels only, not in {level}")


def require_level(level: str) -> None:
    """Refuses levels that nobody has registered.

    Raises:
        ValueError: naming all.
    """
    if level not in LEVELS and level not in EXTRA_LEVELS:
        known = ", ".join((*LEVELS, *EXTRA_LEVELS))
        raise ValueError(f"level must be one of {known}, not {level!r}")


def require_alike(levels: Iterable[str]) -> None:
    """Refuses unknown levels, and those of other packages together with others.

    Raises:
        ValueError: naming them; their tables have other columns.
    """
    found = in_order(levels)
    for level in found:
        require_level(level)
        if level not in LEVELS and len(found) > 1:
            others = ", ".join(name for name in found if name != level)
            raise ValueError(f"level {level} must be driven alone, not with {others}")


def require_filmed(level: str) -> None:
    """Refuses films of levels whose movers are not recorded.

    Raises:
        ValueError: it is none of HOPE's or TPCAP's.
    """
    if level not in LEVELS:
        raise ValueError(f"videos show levels {', '.join(LEVELS)} only, not {level}")


def in_order(levels: Iterable[str]) -> list[str]:
    """Levels as tables list them: those driven by default, then others by name."""
    found = set(levels)
    return [x for x in LEVELS if x in found] + sorted(found - {*LEVELS})


def level_env(level: str, env: EnvConfig) -> EnvConfig:
    """The environment of a level, from that of the suite."""
    return env if level in LEVELS else EXTRA_LEVELS[level].env(env)


def pick_cases(
    level: str, count: int, first: int = 0, with_moving_car: bool = False
) -> Cases:
    """Cases of a level that follow each other, with a moving car or without.

    Args:
        level: whose.
        count: how many.
        first: how many of the level's are left out before them.
        with_moving_car: of HOPE's levels only.

    Raises:
        ValueError: a moving car in cases other than HOPE's.
    """
    if with_moving_car:
        require_aisle(level)
    which = slice(first, first + count)
    if level not in LEVELS:
        return EXTRA_LEVELS[level].pick(which)
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
    if with_moving_car and level in held_out.LEVELS:
        padded = moving_car.add_ends(level, number, parallel, padded)
    kind = np.where(parallel, "parallel", "perpendicular")
    return Cases(level, number, kind, padded)

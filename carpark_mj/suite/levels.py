"""The levels of the suite and their cases, the same for all users.

HOPE's levels have 1,000 held-out cases each. The package stores them, drawn once by
`HopeConfig` from lots of the test split (`carpark_mj.layouts.registry`), in whole
millimetres and 1e-4 rad. Cases of `normal` and `complex` are perpendicular and parallel
in turn, those of `extreme` are parallel. `write` draws the same bytes again.

A package may register an `ExtraLevel`, a fixed list of cases that it stores. The level
may change the suite's environment, and say how its cases begin: with movers, given
starts and goals.
"""

import dataclasses
import functools
import hashlib
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.extensions import Registry
from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.registry import TEST, lot_key
from carpark_mj.layouts.standards import Level, Orientation
from carpark_mj.layouts.types import Layout, WallKind, layout_maxima, pad_layout
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite import moving_car, tpcap
from carpark_mj.suite.hope import HopeConfig


class CaseStart(NamedTuple):
    """How n cases begin.

    Attributes:
        key: (n,) keys, each of a case: of what moves and where others park.
        options: (n, ...) starts and goals.
        movers: (n, ...) states of the environment's movers.
    """

    key: jax.Array
    options: ResetOptions
    movers: tuple[Any, ...]


class Cases(NamedTuple):
    """Some cases of a level.

    Attributes:
        level: its name.
        number: (n,) which of the level's.
        kind: (n,) str, `parallel`, `perpendicular`, or `published` of TPCAP's.
        layouts: (n, ...) of the same shapes in all of HOPE's levels.
        start: how they begin; None = at the spawn region's middle.
    """

    level: str
    number: np.ndarray
    kind: np.ndarray
    layouts: Layout
    start: CaseStart | None = None


@dataclasses.dataclass(frozen=True)
class ExtraLevel:
    """A level.

    Attributes:
        numbers: of its cases.
        sha256: of the data of its cases.
        pick: its cases whose places in `numbers` are in a slice.
        env: its environment, from that of the suite.
    """

    numbers: range
    sha256: str
    pick: Callable[[slice], Cases]
    env: Callable[[EnvConfig], EnvConfig]


EXTRA_LEVELS: Registry[ExtraLevel] = Registry("level of the suite")


VERSION = 1
FILE = Path(__file__).with_name(f"held_out_{VERSION}.npz")
SHA256 = "773f2791aba75242a8e3f765aaa6d1263017e218add2a1b30b8cffaf74989b91"
CASES = 1000  # a level
HOPE_LEVELS: tuple[Level, ...] = get_args(Level)  # driven by default
TPCAP_LEVEL = "tpcap"
LEVELS: tuple[str, ...] = (*HOPE_LEVELS, TPCAP_LEVEL)  # of this package, but for `busy`
METRE, RADIAN = 1e-3, 1e-4  # steps of the numbers in the file
_POSE = np.array([METRE, METRE, RADIAN])


class HeldOut(NamedTuple):
    """The cases of a level.

    Attributes:
        layouts: one each, (1000, ...) and padded alike.
        parallel: (1000,) bool; the others are perpendicular.
    """

    layouts: Layout
    parallel: np.ndarray


def read_published(file: Path, sha256: str) -> dict[str, np.ndarray]:
    """The arrays of an archive in the package.

    Raises:
        ValueError: it is not the published one.
    """
    data = file.read_bytes()
    if (found := hashlib.sha256(data).hexdigest()) != sha256:
        raise ValueError(
            f"{file} has other cases than the published ones: its SHA-256 is {found}, "
            f"not {sha256}"
        )
    with np.load(io.BytesIO(data)) as archive:
        return {name: archive[name] for name in archive.files}


@functools.cache
def load_held_out(level: Level) -> HeldOut:
    """The held-out cases of a level, for the car `tpcap`.

    Raises:
        ValueError: unknown level, or the file in the package is not the published one.
    """
    if level not in HOPE_LEVELS:
        raise ValueError(f"unknown level {level!r}; choose from {sorted(HOPE_LEVELS)}")
    arrays = read_published(FILE, SHA256)
    part = {name: arrays[f"{level}_{name}"] for name in _NAMES}
    return HeldOut(jax.vmap(_layout)(part), part["parallel"])


_NAMES = ("goal", "bay", "start", "wall", "size", "extent", "parallel")


def _layout(case: Any) -> Layout:
    mask = case["size"].any(axis=-1)
    return assemble(
        case["extent"] * METRE,
        bays((case["goal"] * _POSE)[None], case["bay"] * METRE),
        walls(case["wall"] * _POSE, case["size"] * METRE, WallKind.ISLAND, mask),
        spawns((case["start"] * _POSE)[None], (METRE, METRE), 0.0),
    )


def draw_cases(level: Level, count: int = CASES) -> dict[str, np.ndarray]:
    """Draws the first cases of a level, as the file has them: (count, ...) integers."""
    orientations: tuple[Orientation, ...] = ("perpendicular", "parallel")
    if level == "extreme":
        orientations = ("parallel",)
    first = TEST.start + HOPE_LEVELS.index(level) * CASES
    layouts: list[Layout | None] = [None] * count
    # In double precision: the rounded numbers are then the same on any machine.
    with jax.enable_x64(True):
        for turn, orientation in enumerate(orientations):
            draw = jax.jit(HopeConfig(level, orientation).generate)
            for index in range(turn, count, len(orientations)):
                key = lot_key(jnp.uint32(first + index))
                layouts[index] = jax.device_get(draw(key))
    cases = [layout for layout in layouts if layout is not None]
    maxima = layout_maxima(cases)
    stacked = [jax.device_get(pad_layout(case, maxima)) for case in cases]
    lots = jax.tree.map(lambda *rows: np.stack(rows), *stacked)
    parallel = np.arange(count) % len(orientations) == len(orientations) - 1
    return {
        "goal": _whole(lots.bay_pose[:, 0], _POSE, np.int16),
        "bay": _whole(lots.bay_size[:, 0], METRE, np.uint16),
        "start": _whole(lots.spawn_pose[:, 0], _POSE, np.int16),
        "wall": _whole(lots.wall_pose, _POSE, np.int16),
        "size": _whole(lots.wall_size, METRE, np.uint16),
        "extent": _whole(lots.extent, METRE, np.uint16),
        "parallel": parallel,
    }


def _whole(value: np.ndarray, step: float | np.ndarray, kind: type) -> np.ndarray:
    return np.rint(value / step).astype(kind)


def write(path: Path) -> None:
    """Draws all cases and writes them."""
    arrays: dict[str, Any] = {
        f"{level}_{name}": array
        for level in HOPE_LEVELS
        for name, array in draw_cases(level).items()
    }
    with path.open("wb") as file:  # by name, savez would choose another suffix
        np.savez(file, **arrays)


def case_numbers(level: str) -> range:
    """The numbers of a level's cases: of HOPE's from 0, TPCAP's as published.

    Raises:
        ValueError: unknown level.
    """
    if level not in LEVELS:
        require_level(level)
        return EXTRA_LEVELS[level].numbers
    return tpcap.NUMBERS if level == TPCAP_LEVEL else range(CASES)


def fingerprint(level: str) -> str:
    """The first digits of the SHA-256 of the data of a level's cases."""
    if level not in LEVELS:
        return EXTRA_LEVELS[level].sha256[:16]
    return (tpcap.SHA256 if level == TPCAP_LEVEL else SHA256)[:16]


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
    layouts, parallel = load_held_out(level)
    shapes = [load_held_out(name).layouts for name in HOPE_LEVELS]
    maxima, parallel = layout_maxima(shapes), parallel[which]
    padded = jax.vmap(lambda layout: pad_layout(layout, maxima))(
        jax.tree.map(lambda x: x[which], layouts)
    )
    if with_moving_car and level in HOPE_LEVELS:
        padded = moving_car.add_ends(level, number, parallel, padded)
    kind = np.where(parallel, "parallel", "perpendicular")
    return Cases(level, number, kind, padded)

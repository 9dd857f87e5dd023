"""The levels of the suite and their cases, equal for all users.

HOPE's levels have 1,000 held-out cases each. The package stores them, drawn once by
`HopeConfig` from lots of the test split (`carpark_mj.layouts.registry`), in whole
millimetres and 1e-4 rad. Cases of `normal` and `complex` are perpendicular and parallel
in turn, those of `extreme` are parallel.

A package may register a `CaseLevel` of its own. The level may change the suite's
environment, and say how its cases begin: with movers, given starts and goals.
"""

import dataclasses
import functools
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.extensions import Registry
from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.standards import Level
from carpark_mj.layouts.types import Layout, WallKind, layout_maxima, pad_layout
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite import tpcap


class CaseStart(NamedTuple):
    """How n cases begin."""

    key: jax.Array  # (n,) keys, each of a case: of what moves and where others park
    options: ResetOptions  # (n, ...) starts and goals
    movers: tuple[Any, ...]  # (n, ...) states of the environment's movers
    # (n, cars) int32 bays of the parked cars; None = drawn
    parked: jax.Array | None = None


class Cases(NamedTuple):
    """Some cases of a level."""

    level: str  # its name
    number: np.ndarray  # (n,) which of the level's
    # (n,) str, `parallel`, `perpendicular`, `published` of TPCAP's, `recorded` by a
    # car, `repeated` of scenarios, `drawn` of whole lots, the car of `sheets`
    kind: np.ndarray
    layouts: Layout  # (n, ...) of the same shapes in all of HOPE's levels
    # how they begin; None = at the spawn region's middle
    start: CaseStart | None = None


@dataclasses.dataclass(frozen=True)
class CaseLevel:
    """A level: a fixed list of cases."""

    numbers: range  # of its cases
    sha256: str  # of the data of its cases
    pick: Callable[[slice], Cases]  # its cases whose places in `numbers` are in a slice
    # its environment, from that of the suite
    env: Callable[[EnvConfig], EnvConfig] = lambda env: env
    source: str = ""  # of its cases, for tables; empty = `Cases of` the level
    rule: str = ""  # parked rule of its environment; empty = the suite's
    vehicle: str = ""  # of its environment; empty = the suite's

    @property
    def fingerprint(self) -> str:
        """The first digits of `sha256`."""
        return self.sha256[:16]


# Levels, and makers of those of a file or a car, `NAME:PATH` or `NAME:CAR`, from that.
LEVELS: Registry[Any] = Registry("level")
VERSION = 1
FILE = Path(__file__).with_name(f"held_out_{VERSION}.npz")
SHA256 = "773f2791aba75242a8e3f765aaa6d1263017e218add2a1b30b8cffaf74989b91"
CASES = 1000  # a level
HOPE_LEVELS: tuple[Level, ...] = get_args(Level)  # driven by default
TPCAP_LEVEL = "tpcap"
METRE, RADIAN = 1e-3, 1e-4  # steps of the numbers in the file
POSE = np.array([METRE, METRE, RADIAN])


def read_published(file: Path, sha256: str) -> dict[str, np.ndarray]:
    """The arrays of an archive in the package; ValueError if it was changed."""
    data = file.read_bytes()
    tpcap.require_published(file, data, sha256)
    with np.load(io.BytesIO(data)) as archive:
        return {name: archive[name] for name in archive.files}


@functools.cache
def load_held_out(level: Level) -> tuple[Layout, np.ndarray]:
    """Held-out cases (1000, ...), padded alike, and which are parallel, for `tpcap`."""
    arrays = read_published(FILE, SHA256)
    part = {name: arrays[f"{level}_{name}"] for name in STORED}
    return jax.vmap(_layout)(part), part["parallel"]


STORED = ("goal", "bay", "start", "wall", "size", "extent", "parallel")


def _layout(case: Any) -> Layout:
    mask = case["size"].any(axis=-1)
    return assemble(
        case["extent"] * METRE,
        bays((case["goal"] * POSE)[None], case["bay"] * METRE),
        walls(case["wall"] * POSE, case["size"] * METRE, WallKind.ISLAND, mask),
        spawns((case["start"] * POSE)[None], (METRE, METRE), 0.0),
    )


def _pick_hope(level: Level, which: slice) -> Cases:
    layouts, parallel = load_held_out(level)
    maxima = layout_maxima([load_held_out(name)[0] for name in HOPE_LEVELS])
    pad = jax.vmap(lambda layout: pad_layout(layout, maxima))
    padded = pad(jax.tree.map(lambda x: x[which], layouts))
    kind = np.where(parallel[which], "parallel", "perpendicular")
    return Cases(level, np.arange(CASES)[which], kind, padded)


def _pick_tpcap(which: slice) -> Cases:
    number = np.array(tpcap.NUMBERS[which])
    layouts = jax.tree.map(lambda x: x[which], tpcap.load_tpcap())
    return Cases(TPCAP_LEVEL, number, np.full(len(number), "published"), layouts)


_HELD_OUT = f"Held-out cases version {VERSION}"
for _level in HOPE_LEVELS:
    _pick = functools.partial(_pick_hope, _level)
    LEVELS.register(_level, CaseLevel(range(CASES), SHA256, _pick, source=_HELD_OUT))
LEVELS.register(
    TPCAP_LEVEL,
    CaseLevel(tpcap.NUMBERS, tpcap.SHA256, _pick_tpcap, source="TPCAP's cases"),
)


def find_level(level: str) -> CaseLevel:
    """A level by name; `ValueError` if there is none, or its files are faulty."""
    name, _, rest = level.partition(":")
    found = LEVELS[name]
    return LEVELS[level] if isinstance(found, CaseLevel) else found(rest)


def require_filmed(level: str) -> None:
    """Refuses films from files, which lack what moves and parks in some levels."""
    if find_level(level).pick(slice(0, 1)).start is not None:
        raise ValueError(
            f"files lack the movers and parked cars of level {level}: make its videos "
            "with the command that drives it, without --combine"
        )


def in_order(levels: Iterable[str]) -> list[str]:
    """Levels as tables list them: those of this module, then others by name."""
    first, found = (*HOPE_LEVELS, TPCAP_LEVEL), {*levels}
    return [x for x in first if x in found] + sorted(found - {*first})


def pick_cases(level: str, count: int, first: int = 0) -> Cases:
    """So many cases of a level from the `first` on."""
    return find_level(level).pick(slice(first, first + count))

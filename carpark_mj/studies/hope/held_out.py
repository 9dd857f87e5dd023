"""The held-out cases of HOPE's levels: 1,000 each, the same for all users.

The package stores them, drawn once by `HopeConfig` from lots of the test split
(`carpark_mj.layouts.splits`), in whole millimetres and 1e-4 rad. Cases of `normal` and
`complex` are perpendicular and parallel in turn, those of `extreme` are parallel.
`write` draws the same bytes again.
"""

import functools
import hashlib
import io
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.splits import TEST, lot_key
from carpark_mj.layouts.standards import Level, Orientation
from carpark_mj.layouts.types import Layout, WallKind, layout_maxima, pad_layout
from carpark_mj.studies.hope.layouts import HopeConfig

VERSION = 1
FILE = Path(__file__).with_name(f"held_out_{VERSION}.npz")
SHA256 = "773f2791aba75242a8e3f765aaa6d1263017e218add2a1b30b8cffaf74989b91"
CASES = 1000  # a level
LEVELS: tuple[Level, ...] = get_args(Level)
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


@functools.cache
def load_held_out(level: Level) -> HeldOut:
    """The held-out cases of a level, for the car `tpcap`.

    Raises:
        ValueError: unknown level, or the file in the package is not the published one.
    """
    if level not in LEVELS:
        raise ValueError(f"unknown level {level!r}; choose from {sorted(LEVELS)}")
    data = FILE.read_bytes()
    if (found := hashlib.sha256(data).hexdigest()) != SHA256:
        raise ValueError(
            f"{FILE} is not version {VERSION} of the held-out cases: its SHA-256 is "
            f"{found}, not {SHA256}"
        )
    with np.load(io.BytesIO(data)) as file:
        part = {name: file[f"{level}_{name}"] for name in _NAMES}
    return HeldOut(jax.vmap(_layout)(part), part["parallel"])


_NAMES = ("goal", "bay", "start", "wall", "size", "extent", "parallel")


def _layout(case: dict[str, jax.Array]) -> Layout:
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
    first = TEST.start + LEVELS.index(level) * CASES
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
        for level in LEVELS
        for name, array in draw_cases(level).items()
    }
    with path.open("wb") as file:  # by name, savez would choose another suffix
        np.savez(file, **arrays)

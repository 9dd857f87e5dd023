"""Lots at other scales, and lots drawn once and kept.

A mixture compiles the code of all of its families. Lots that are kept are data: a
program picks one, whatever drew it, and draws only its scale anew.
"""

import contextlib
import dataclasses
import functools
import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.compilation import cache_folder
from carpark_mj.config.checks import Bounds, Count, Range
from carpark_mj.files import write_atomically
from carpark_mj.layouts.base import FAMILIES, LayoutConfig
from carpark_mj.layouts.registry import lot_key, lot_number
from carpark_mj.layouts.schematics import SQUARE_COMPACT
from carpark_mj.layouts.standards import Entry
from carpark_mj.layouts.types import Layout, enlarge, layout_maxima, mirror, pad_layout

VERSION = 2  # of the drawing of lots: files of another are not read
CHUNK = 64  # lots drawn at a time


@dataclasses.dataclass(frozen=True)
class ChangedConfig(LayoutConfig):
    """Lots of another config, changed."""

    lots: LayoutConfig = SQUARE_COMPACT  # the other config

    @property
    def min_bays(self) -> int:
        """As of the lots."""
        return self.lots.min_bays

    @property
    def min_goals(self) -> int:
        """As of the lots."""
        return self.lots.min_goals

    @property
    def is_enclosed(self) -> bool:
        """As of the lots."""
        return self.lots.is_enclosed


@dataclasses.dataclass(frozen=True)
class ScaledConfig(ChangedConfig):
    """Lots of which all lengths are multiplied by a factor, drawn for every lot."""

    scale: Annotated[Range, Bounds(ge=0.5, le=2.0)] = (1.0, 1.0)
    family: str = "scaled"

    def split(self) -> tuple["_Scaled", Any]:
        """As the lots."""
        draw, numbers = self.lots.split()
        return _Scaled(draw), (numbers, self.scale)

    def generate(self, key: jax.Array) -> Layout:
        """Draws a lot and its scale."""
        draw, numbers = self.split()
        return draw(numbers, key)


@dataclasses.dataclass(frozen=True)
class _Scaled:
    """Draws lots and their scales."""

    draw: Callable[[Any, jax.Array], Layout]

    def __call__(self, numbers: Any, key: jax.Array) -> Layout:
        key, scale_key = jax.random.split(key)
        numbers, (low, high) = numbers
        factor = jax.random.uniform(scale_key, (), jnp.float32, low, high)
        return enlarge(self.draw(numbers, key), factor)


@dataclasses.dataclass(frozen=True)
class StoredConfig(ChangedConfig):
    """Lots for training that are drawn once, on the CPU, and kept in the user's cache.

    Half of those that are picked are mirrored, and `ScaledConfig`s draw the scale of
    each anew. All are of the split `train`: evaluate in the lots themselves.

    Attributes:
        number: of lots that are kept, by their shares of a mixture.
    """

    number: Count = 8192
    family: str = "stored"

    def generate(self, key: jax.Array) -> Layout:
        """Picks a member of the mixture, then a lot of it."""
        pick_key, key = jax.random.split(key)
        shares = jnp.array([share for _, share in self.shares], jnp.float32)
        return self.generate_member(
            jax.random.categorical(pick_key, jnp.log(shares)), key
        )

    def generate_member(self, member: jax.Array, key: jax.Array) -> Layout:
        """Picks a lot of one member, () int32."""
        row_key, scale_key, side_key = jax.random.split(key, 3)
        counts = jnp.array(self.counts, jnp.int32)
        first = jnp.cumsum(counts) - counts
        row = first[member] + jax.random.randint(row_key, (), 0, counts[member])
        lot = jax.tree.map(lambda x: jnp.asarray(x)[row], stored_lots(self))
        low, high = jnp.array([_scale(lots) for lots, _ in self.shares]).T
        factor = jax.random.uniform(scale_key, ()) * (high - low)[member] + low[member]
        lot = enlarge(lot, factor)
        mirrored = jax.random.bernoulli(side_key)
        return jax.tree.map(lambda x, y: jnp.where(mirrored, x, y), mirror(lot), lot)

    @property
    def counts(self) -> tuple[int, ...]:
        """How many lots of each member are kept."""
        return tuple(max(round(share * self.number), 1) for _, share in self.shares)

    @property
    def shares(self) -> tuple[tuple[LayoutConfig, float], ...]:
        """Shares of the lots."""
        return self.lots.shares

    @property
    def parts(self) -> tuple[LayoutConfig, ...]:
        """Parts of the lots."""
        return self.lots.parts

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Entries of the lots."""
        return self.lots.entries


def _scale(lots: LayoutConfig) -> Range:
    return lots.scale if isinstance(lots, ScaledConfig) else (1.0, 1.0)


@functools.cache
def stored_lots(config: StoredConfig) -> Layout:
    """The lots of a config (n, ...), member by member, from a file or for a file."""
    told = repr((VERSION, config.lots, config.number)).encode()
    name = f"lots-{hashlib.sha256(told).hexdigest()[:16]}.npz"
    try:
        file: Path | None = cache_folder().parent / name
    except RuntimeError:  # no home
        file = None
    damaged = (OSError, ValueError, TypeError, zipfile.BadZipFile)
    if file is not None:
        with contextlib.suppress(*damaged), np.load(file) as arrays:
            return Layout(**dict(arrays))
    with jax.ensure_compile_time_eval(), jax.default_device(jax.devices("cpu")[0]):
        lots = _draw(config)
    arrays = {name: x for name, x in vars(lots).items() if x is not None}
    if file is not None:
        with contextlib.suppress(OSError):  # a folder that cannot be written
            file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            write_atomically(file, lambda opened: np.savez_compressed(opened, **arrays))
    return lots


def _draw(config: StoredConfig) -> Layout:
    """Draws all lots, of the split `train`; mixtures' members one after the other."""
    members: list[LayoutConfig] = [
        lots.lots if isinstance(lots, ScaledConfig) else lots
        for lots, _ in config.shares
    ]
    key = jax.random.key(0)
    maxima = layout_maxima(jax.eval_shape(lots.generate, key) for lots in members)

    @functools.partial(jax.jit, static_argnums=0)
    def draw(lots: LayoutConfig, keys: jax.Array) -> Layout:
        keys = jax.vmap(lambda key: lot_key(lot_number("train", key)))(keys)
        return jax.vmap(lambda key: pad_layout(lots.generate(key), maxima))(keys)

    drawn = list[Layout]()
    for seed, (lots, count) in enumerate(zip(members, config.counts, strict=True)):
        keys = jax.random.split(jax.random.key(seed), -(-count // CHUNK) * CHUNK)
        chunks = [jax.device_get(draw(lots, x)) for x in keys.reshape(-1, CHUNK)]
        drawn.append(jax.tree.map(lambda *x, n=count: np.concatenate(x)[:n], *chunks))
    return jax.tree.map(lambda *x: np.concatenate(x), *drawn)


for _family in (ScaledConfig, StoredConfig):
    FAMILIES.register(_family.family, _family)

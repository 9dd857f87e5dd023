"""The 20 published cases of TPCAP, in the package as they were published.

Their sources are in `data/README.md`; `carpark_mj.studies.tpcap.files` reads them.
"""

import dataclasses
import functools
import hashlib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.layouts import Layout
from carpark_mj.studies.tpcap.files import read_tpcap

FOLDER = Path(__file__).with_name("data")
# Of the texts of the files in the order of their numbers.
SHA256 = "7ea190e8b7b5a0639d7681d573e9712b1967a77864932a7a8ca18923de95dfb3"
NUMBERS = range(1, 21)


@dataclasses.dataclass(frozen=True)
class TpcapConfig(LayoutConfig):
    """A published case of TPCAP.

    Attributes:
        case: its number, 1 to 20; None = any of them.
        family: fixed.
    """

    case: int | None = None
    family: str = "tpcap"

    def __post_init__(self) -> None:
        super().__post_init__()
        known = type(self.case) is int and self.case in NUMBERS  # True is 1, too
        if self.case is not None and not known:
            raise ValueError(
                f"case must be {NUMBERS[0]} to {NUMBERS[-1]}, not {self.case!r}"
            )

    @property
    def is_enclosed(self) -> bool:
        """Cars can leave; no walls stand around the lot."""
        return False

    @property
    def min_bays(self) -> int:
        """One, the goal."""
        return 1

    @property
    def is_random(self) -> bool:
        """Whether the case depends on the key."""
        return self.case is None

    def generate(self, key: jax.Array) -> Layout:
        """The layout of a case; of any, padded alike, if none is named."""
        if self.case is not None:
            return jax.tree.map(jnp.asarray, _read(self.case))
        pick = jax.random.randint(key, (), 0, len(NUMBERS))
        return jax.tree.map(lambda rows: jnp.asarray(rows)[pick], load_tpcap())


register_layout("tpcap", TpcapConfig())
for number in NUMBERS:
    register_layout(f"tpcap_{number}", TpcapConfig(number))


@functools.cache
def load_tpcap() -> Layout:
    """All cases, (20, ...) and padded alike, as numpy arrays.

    Raises:
        ValueError: the files in the package are not the published ones.
    """

    def stack(*parts: np.ndarray) -> np.ndarray:
        most = max(len(part) for part in parts)
        # As `pad_layout` does, which would be compiled for each case.
        more = [[(0, most - len(part)), *[(0, 0)] * (part.ndim - 1)] for part in parts]
        return np.stack(list(map(np.pad, parts, more)))

    return jax.tree.map(stack, *map(_read, NUMBERS))


@functools.cache
def _read(number: int) -> Layout:
    with jax.ensure_compile_time_eval():  # also while a program is traced
        return jax.device_get(read_tpcap(published_files()[number]))


@functools.cache
def published_files() -> dict[int, Path]:
    """The files by number, once they have been compared with the published ones."""
    files = {number: FOLDER / f"case{number}.csv" for number in NUMBERS}
    texts = [file.read_text(encoding="utf-8") for file in files.values()]
    if (found := hashlib.sha256("".join(texts).encode()).hexdigest()) != SHA256:
        raise ValueError(
            f"{FOLDER} has other cases than the published ones: their SHA-256 is "
            f"{found}, not {SHA256}"
        )
    return files

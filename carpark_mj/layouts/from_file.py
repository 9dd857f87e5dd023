"""A lot from a file: JSON, in which a car park can be drawn by hand, or TPCAP CSV."""

import dataclasses
import functools
from pathlib import Path

import jax
import jax.numpy as jnp

from carpark_mj.config import LAYOUT_FILES, LayoutConfig
from carpark_mj.layouts.json_file import read_json
from carpark_mj.layouts.tpcap import read_tpcap
from carpark_mj.layouts.types import Layout


@dataclasses.dataclass(frozen=True)
class FromFileConfig(LayoutConfig):
    """A layout file, read when the config is made.

    Attributes:
        path: `.json` (see `carpark_mj.layouts.json_file`) or `.csv` (a TPCAP case, see
            `carpark_mj.layouts.tpcap`).
        family: fixed.
    """

    path: str = ""
    family: str = "from_file"

    def __post_init__(self) -> None:
        if not self.path.endswith(LAYOUT_FILES):
            raise ValueError(
                f"path must end in one of {', '.join(LAYOUT_FILES)}, not {self.path!r}"
            )
        _read(self.path)

    @property
    def is_enclosed(self) -> bool:
        """Unknown, so taken for False."""
        return False

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return int(_read(self.path).bay_mask.sum())

    @property
    def min_goals(self) -> int:
        """The fewest bays that any key gives that are not reserved for parked cars."""
        return int(_read(self.path).goal_mask.sum())

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
        return False


@functools.cache
def _read(path: str) -> Layout:
    """The layout of a file as numpy arrays, read once a process."""
    reader = read_json if path.endswith(".json") else read_tpcap
    return jax.device_get(reader(Path(path)))


def from_file(config: FromFileConfig, key: jax.Array) -> Layout:
    """The layout of the file; the key is unused."""
    del key
    return jax.tree.map(jnp.asarray, _read(config.path))

"""A lot from a file: JSON, in which a car park can be drawn by hand, or TPCAP CSV."""

import dataclasses
import functools
import hashlib
from pathlib import Path

import jax
import jax.numpy as jnp

from carpark_mj.config import LAYOUT_FILES, LayoutConfig
from carpark_mj.layouts.json_file import read_json
from carpark_mj.layouts.tpcap import read_tpcap
from carpark_mj.layouts.types import Layout
from carpark_mj.reading import read_bytes


@dataclasses.dataclass(frozen=True, eq=False)
class FromFileConfig(LayoutConfig):
    """A layout file, read when the config is made.

    Configs are equal if both paths and contents are: one of a file that has changed is
    another.

    Attributes:
        path: `.json` (see `carpark_mj.layouts.json_file`) or `.csv` (a TPCAP case, see
            `carpark_mj.layouts.tpcap`).
        family: fixed.
    """

    path: str = ""
    family: str = "from_file"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.path.endswith(LAYOUT_FILES):
            raise ValueError(
                f"path must end in one of {', '.join(LAYOUT_FILES)}, not {self.path!r}"
            )
        _read(self.path, self._content)  # refuses a bad file

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FromFileConfig) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[str, str]:
        return self.path, self._content

    @functools.cached_property
    def _content(self) -> str:
        """A hash of what is in the file; empty if it cannot be read."""
        try:
            return hashlib.sha256(read_bytes(Path(self.path))).hexdigest()
        except (OSError, ValueError):  # the reader says what is wrong
            return ""

    @property
    def layout(self) -> Layout:
        """As the file had it when the config was made."""
        return _read(self.path, self._content)

    @property
    def is_enclosed(self) -> bool:
        """Unknown, so taken for False."""
        return False

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return int(self.layout.bay_mask.sum())

    @property
    def min_goals(self) -> int:
        """The fewest bays that any key gives that are not reserved for parked cars."""
        return int(self.layout.goal_mask.sum())

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
        return False


@functools.cache
def _read(path: str, content: str) -> Layout:
    """The layout of a file as numpy arrays, read once for each content."""
    del content
    reader = read_json if path.endswith(".json") else read_tpcap
    return jax.device_get(reader(Path(path)))


def from_file(config: FromFileConfig, key: jax.Array) -> Layout:
    """The layout of the file; the key is unused."""
    del key
    return jax.tree.map(jnp.asarray, config.layout)

"""A lot from a file, of any of the `LAYOUT_FORMATS`."""

import dataclasses
import functools
import hashlib
from pathlib import Path

import jax

from carpark_mj.config.layouts import (
    FAMILIES,
    LAYOUT_FORMATS,
    layout_format,
    require_layout_file,
)
from carpark_mj.layouts.fixed import FixedLayoutConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.reading import read_bytes


@dataclasses.dataclass(frozen=True, eq=False)
class FromFileConfig(FixedLayoutConfig):
    """A layout file, read when the config is made.

    Configs are equal if paths and contents are equal; a changed file gives another
    config.

    Attributes:
        path: of the file; its suffix says the format: `.json`, in which a car park can
            be drawn by hand (`carpark_mj.layouts.json_file`), or that of an extension.
        family: fixed.
    """

    path: str = ""
    family: str = "from_file"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_layout_file(self.path)
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


@functools.cache
def _read(path: str, content: str) -> Layout:
    """The layout of a file as numpy arrays, read once for each content."""
    del content
    return jax.device_get(LAYOUT_FORMATS[layout_format(path)](Path(path)))


FAMILIES.register("from_file", FromFileConfig)

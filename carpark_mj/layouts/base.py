"""Which lot: the base of the layouts' configs, and the registries of their names."""

import abc
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import jax

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.extensions import Registry
from carpark_mj.layouts.standards import Entry
from carpark_mj.layouts.types import Layout


class LayoutConfig(CheckedConfig, abc.ABC):
    """A family of lots: a frozen dataclass of its settings, which draws them.

    Attributes:
        family: its name in files, the default of each class and never another.
        car: the `DesignCar` that bays and spawn regions have room for; None = one
            with its defaults.
        spawn_margin: free ground around spawn regions for larger cars [m].
        is_random: whether lots depend on the key.
        is_enclosed: whether walls keep cars within the lot, and observations in range.
    """

    family: str
    car: Any = None
    spawn_margin: float = 0.0
    is_random = True
    is_enclosed = True

    @abc.abstractmethod
    def generate(self, key: jax.Array) -> Layout:
        """Draws a lot: equal for equal keys, of equal shapes for all."""

    def generate_member(self, member: jax.Array, key: jax.Array) -> Layout:
        """Draws a lot of one member, () int32, of a mixture; there is none here."""
        del member
        return self.generate(key)

    def split(self) -> tuple[Callable[[Any, jax.Array], Layout], Any]:
        """What draws lots from numbers and a key, and the numbers, a pytree.

        Members of a mixture with equal functions share its program.
        """
        return self._draw, ()

    def _draw(self, _: Any, key: jax.Array) -> Layout:
        return self.generate(key)

    @property
    @abc.abstractmethod
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""

    @property
    def min_goals(self) -> int:
        """The fewest bays that any key gives that are not reserved for parked cars."""
        return self.min_bays

    @property
    def parts(self) -> "tuple[LayoutConfig, ...]":
        """What lots are drawn from: itself, or the members of a mixture."""
        return (self,)

    @property
    def shares(self) -> "tuple[tuple[LayoutConfig, float], ...]":
        """Like `parts`, but nested mixtures stay whole; each with its share of lots."""
        return ((self, 1.0),)

    @property
    def layout(self) -> Layout | None:
        """The only lot, if a file has it; else None."""
        return None

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The widest entries, one of which a car must fit through; empty if unknown."""
        return ()


Config = TypeVar("Config", bound=LayoutConfig)
_PARTS = "schematics", "lot", "tight", "mixtures", "stored", "car_park", "clutter"
_HOMES = [f"carpark_mj.layouts.{name}" for name in (*_PARTS, "files")]
LAYOUTS: Registry[LayoutConfig] = Registry("layout", *_HOMES)
# Classes by their `family`, so that configs can be read from files.
FAMILIES: Registry[type[LayoutConfig]] = Registry("family", *_HOMES)
# What reads a layout from a file, by the suffix of the file's name.
LAYOUT_FORMATS: Registry[Callable[[Path], Layout]] = Registry(
    "layout format", "carpark_mj.layouts.files"
)
# The text of a lot in a file, by the suffix of the file's name.
LAYOUT_WRITERS: Registry[Callable[[Layout], str]] = Registry(
    "format to save", "carpark_mj.layouts.files"
)


def register_layout(name: str, config: Config) -> Config:
    """Names a layout and its family; `ValueError` if either is another one's."""
    FAMILIES.register(config.family, type(config))
    LAYOUTS.register(name, config)
    return config


def layout_format(name: str) -> str:
    """The format of a layout file; empty for the name of a layout, without a dot."""
    return name.rpartition(".")[2] if "." in name else ""


def require_layout(name: str) -> None:
    """Raises `ValueError` unless a name is that of a layout or a layout file."""
    suffix = layout_format(name)
    _ = LAYOUT_FORMATS[suffix] if suffix else LAYOUTS[name]


# tyro turns a union with dataclasses into subcommands; as a flag a layout is its name.
if TYPE_CHECKING:
    LayoutChoice = LayoutConfig | str
else:
    LayoutChoice = str

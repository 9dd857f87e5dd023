"""Which lot: names, files, and the base of the families' configs."""

import abc
from typing import TYPE_CHECKING, Any, Literal, get_args

from carpark_mj.config.checks import CheckedConfig

# Layouts given by name alone; `carpark_mj.layouts` defines them.
LayoutName = Literal[
    "angled",
    "compact",
    "dead_end",
    "garage_row",
    "hope_complex_parallel",
    "hope_complex_perpendicular",
    "hope_extreme_parallel",
    "hope_normal_parallel",
    "hope_normal_perpendicular",
    "lot",
    "metadrive",
    "mixture",
    "slots",
    "slots_diagonal",
    "slots_parallel",
    "slots_single",
    "slots_single_diagonal",
    "square",
    "street",
    "street_parallel",
    "tanner",
    "tpcap",
]
TPCAP_NAMES = tuple(f"tpcap_{number}" for number in range(1, 21))  # one case each
LAYOUT_FILES = (".json", ".csv")


def require_layout(name: str) -> None:
    """Refuses what is neither the name of a layout nor that of a layout file.

    Raises:
        ValueError: with the known names.
    """
    known = sorted(get_args(LayoutName))
    if not name.endswith(LAYOUT_FILES) and name not in (*known, *TPCAP_NAMES):
        raise ValueError(
            f"unknown layout {name!r}; choose from {known}, or {TPCAP_NAMES[0]} to "
            f"{TPCAP_NAMES[-1]}, or name a file ({', '.join(LAYOUT_FILES)})"
        )


class LayoutConfig(CheckedConfig, abc.ABC):
    """Base of the configs in `carpark_mj.layouts`, one frozen dataclass per family.

    Attributes:
        family: name of the generator.
    """

    family: str

    @property
    @abc.abstractmethod
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""

    @property
    def min_goals(self) -> int:
        """The fewest bays that any key gives that are not reserved for parked cars."""
        return self.min_bays

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
        return True

    @property
    def is_enclosed(self) -> bool:
        """Whether walls keep cars within the lot, and observations within ranges."""
        return True

    @property
    def entries(self) -> tuple[Any, ...]:
        """The widest entries into bays, `carpark_mj.layouts.turning.Entry`.

        A car that can enter a bay in none of these can enter none in any lot of this
        config; empty if unknown.
        """
        return ()


# tyro turns a union with dataclasses into subcommands; as a flag a layout is its name.
if TYPE_CHECKING:
    LayoutChoice = LayoutConfig | str
else:
    LayoutChoice = str

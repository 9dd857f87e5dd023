"""Which lot: names, files, and the base of the families' configs."""

from typing import TYPE_CHECKING, Any, Literal

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
]
LAYOUT_FILES = (".json", ".csv")


class LayoutConfig:
    """Base of the configs in `carpark_mj.layouts`, one frozen dataclass per family.

    Attributes:
        family: name of the generator.
    """

    family: str

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        raise NotImplementedError

    @property
    def min_goals(self) -> int:
        """The fewest bays that any key gives that are not reserved for parked cars."""
        return self.min_bays

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
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

"""A mixture: every key draws a family first, then one of its lots.

All lots of a mixture are padded to the same numbers of rows, so that a batch may hold
lots of different families, and all keys share one compiled program.
"""

import dataclasses
import math

from carpark_mj.config import LayoutConfig
from carpark_mj.layouts.angled import AngledConfig
from carpark_mj.layouts.square import COMPACT
from carpark_mj.layouts.street import StreetConfig, StreetParallelConfig
from carpark_mj.layouts.turning import Entry


@dataclasses.dataclass(frozen=True)
class MixtureConfig(LayoutConfig):
    """A distribution over families.

    Attributes:
        members: configs of the families.
        weights: how often each is drawn, in proportion; empty = equally often.
        family: fixed.
    """

    members: tuple[LayoutConfig, ...] = (
        COMPACT,
        StreetConfig(),
        StreetParallelConfig(),
        AngledConfig(),
    )
    weights: tuple[float, ...] = ()
    family: str = "mixture"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.members:
            raise ValueError("members of a mixture must be one config or more, not ()")
        if self.weights and len(self.weights) != len(self.members):
            raise ValueError(
                f"weights must be one for each of the {len(self.members)} members, "
                f"not {self.weights}"
            )
        if any(not (math.isfinite(w) and w > 0) for w in self.weights):
            raise ValueError(f"weights must be positive, not {self.weights}")

    @property
    def is_enclosed(self) -> bool:
        """Whether walls keep cars within all of its lots."""
        return all(member.is_enclosed for member in self.members)

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return min(member.min_bays for member in self.members)

    @property
    def min_goals(self) -> int:
        """The fewest bays for goals that any key gives."""
        return min(member.min_goals for member in self.members)

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Those of all members; not known if those of one are not."""
        entries = [member.entries for member in self.members]
        return sum(entries, ()) if all(entries) else ()

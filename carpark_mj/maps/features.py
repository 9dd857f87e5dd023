"""Features of maps in any format: tagged shapes in metres."""

import dataclasses
from collections import Counter
from typing import Any, Literal

from carpark_mj.layouts.types import BayKind

Tag = Literal["bay", "lane", "wall", "kerb", "pillar", "drivable", "start"]

MOST_KINDS = 10  # named in a message
LINE_THICKNESS = 0.2  # m of walls and kerbs drawn as lines


@dataclasses.dataclass(frozen=True)
class Feature:
    """One shape of a map.

    Attributes:
        tag: its meaning.
        shape: a shapely polygon, of a lane the centre line in its direction [m].
        name: its name in the map.
        kind: of a bay.
        width: of a lane [m].
        one_way: whether a lane is driven along its line only.
        yaw: heading of a start that has one [rad].
    """

    tag: Tag
    shape: Any
    name: str
    kind: BayKind = BayKind.STANDARD
    width: float = 0.0
    one_way: bool = False
    yaw: float | None = None


@dataclasses.dataclass(frozen=True)
class Plan:
    """The features of a map.

    Attributes:
        features: in the map's order, metres.
        unknown: numbers of unknown elements by kind.
        lost: spots that cannot become shapes, with the reason, by their names.
    """

    features: list[Feature] = dataclasses.field(default_factory=list)
    unknown: Counter[str] = dataclasses.field(default_factory=Counter)
    lost: dict[str, str] = dataclasses.field(default_factory=dict)


def commonest(counts: Counter[str]) -> str:
    """The commonest kinds with their numbers, and how many others there are."""
    named = [f"{number} {kind}" for kind, number in counts.most_common(MOST_KINDS)]
    if more := len(counts) - len(named):
        rest = counts.total() - sum(n for _, n in counts.most_common(MOST_KINDS))
        named.append(f"{rest} of {more} other kinds")
    return ", ".join(named)

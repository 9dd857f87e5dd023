"""Features of maps in any format: tagged shapes in metres about their middle."""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
import pyproj
import shapely
from pyproj.exceptions import ProjError

from carpark_mj.layouts.types import BayKind

WGS84 = "EPSG:4326"
FARTHEST = 1_000.0  # m from the middle: maps of at most 2 km
Tag = Literal["bay", "lane", "wall", "kerb", "pillar", "drivable", "start"]
MOST_KINDS, NAMED = 10, 5  # kinds and names in a message
STRETCH = 0.1  # m by which a spot may be too short for the car
BEND = 0.5  # m between a curved lane and its straight parts
LINE_THICKNESS = 0.2  # m of walls and kerbs drawn as lines


def to_metres(coordinates: np.ndarray, system: str = WGS84) -> np.ndarray:
    """Projects coordinates onto a plane that touches the earth in their middle.

    They are (n, 2) longitude and latitude, or east and north, in a coordinate reference
    system in any form that PROJ knows. Returns (n, 2) east and north of the middle [m].

    Raises:
        ValueError: unknown system, points that it does not have, or too far apart.
    """
    if not np.isfinite(coordinates).all():
        raise ValueError("coordinates must be finite")
    middle = (coordinates.min(axis=0) + coordinates.max(axis=0)) / 2
    try:
        crs: Any = pyproj.CRS.from_user_input(system)
        there = pyproj.Transformer.from_crs(crs, WGS84, always_xy=True)
        lon, lat = there.transform(*middle, errcheck=True)
        if crs.is_geographic and not (abs(lon) <= 180 and abs(lat) <= 90):
            raise ValueError(
                f"longitude and latitude must lie within ±180° and ±90°, not "
                f"{middle[0]:g} and {middle[1]:g}; if these are projected, name their "
                f"system: --crs EPSG:..."
            )
        local = f"+proj=tmerc +lon_0={lon} +lat_0={lat} +datum=WGS84 +units=m"
        project = pyproj.Transformer.from_crs(crs, local, always_xy=True)
        xy = np.stack(project.transform(*coordinates.T, errcheck=True), axis=-1)
    except ProjError as error:
        raise ValueError(f"coordinate reference system {system!r}: {error}") from None
    return _checked(xy)


def centred(xy: np.ndarray) -> np.ndarray:
    """Coordinates (n, 2) [m] from their middle; `ValueError` beyond 2 km."""
    return _checked(xy - (xy.min(axis=0) + xy.max(axis=0)) / 2)


def _checked(xy: np.ndarray) -> np.ndarray:
    """The coordinates, if they are finite and not more than 2 km apart."""
    if not np.isfinite(xy).all():
        raise ValueError("coordinates must be finite")
    size = np.ptp(xy, axis=0)
    if size.max() > 2 * FARTHEST:
        raise ValueError(
            f"the map is {size[0] / 1e3:.3g} x {size[1] / 1e3:.3g} km; at most "
            f"{2 * FARTHEST / 1e3:g} km: cut one car park out of it"
        )
    return xy


@dataclasses.dataclass(frozen=True)
class Feature:
    """One shape of a map."""

    tag: Tag | Literal["spots"]  # bays without outlines of their own
    # A shapely polygon, of a lane the centre line in its direction [m]; of spots around
    # all of them and maybe their aisles, or the point of one.
    shape: Any
    name: str  # in the map
    kind: BayKind = BayKind.STANDARD  # of a bay, or of spots
    level: str = ""  # floors that it belongs to, separated by semicolons; all if empty
    count: int = 0  # of spots; 0 if the map does not say
    orientation: str = ""  # of spots: `parallel`, `perpendicular`, `diagonal`, or empty
    is_row: bool = False  # whether the polygon holds spots alone, without an aisle
    width: float = 0.0  # of a lane [m]
    one_way: bool = False  # whether a lane is driven along its line only
    yaw: float | None = None  # heading of a start that has one [rad]


@dataclasses.dataclass
class Report:
    """Report of an import, to which every step adds."""

    spots: int = 0  # in the map
    # Why spots have no bay, by their names.
    lost: dict[str, str] = dataclasses.field(default_factory=dict)
    # Numbers of elements: unknown ones by kind, those outside the drivable part by tag.
    unknown: Counter[str] = dataclasses.field(default_factory=Counter)
    outside: Counter[str] = dataclasses.field(default_factory=Counter)
    # Between the outlines of spots and of their bays [m].
    errors: list[float] = dataclasses.field(default_factory=list)
    # Names of spots lengthened into the aisle to hold the car, and left to parked cars.
    stretched: list[str] = dataclasses.field(default_factory=list)
    turned: float = 0.0  # angle by which the map was turned to the rows of bays [rad]
    # From the map's frame to the lot's, after that turn: x + iy [m]; 0 in formats whose
    # coordinates are projected.
    shift: complex = 0j
    # Sentences on what was assumed.
    notes: list[str] = dataclasses.field(default_factory=list)

    def __str__(self) -> str:
        """The report as lines of text."""
        lines = []
        if self.errors:  # else a recorded case, taken as it is
            worst, mean = max(self.errors), float(np.mean(self.errors))
            lines = [
                f"{len(self.errors)} of {self.spots} spots imported; their rectangles "
                f"are off by {mean:.2f} m on average, {worst:.2f} m at most",
                f"turned by {np.degrees(self.turned):.1f} deg to its rows",
            ]
        lines += self.notes
        left: dict[str, list[str]] = {}
        for name, why in self.lost.items():
            kind, _, detail = why.partition(": ")
            left.setdefault(kind, []).append(f"{name} ({detail})" if detail else name)
        for kind, names in left.items():
            lines.append(f"left out, {kind}: {len(names)} spots, {first_names(names)}")
        if self.stretched:
            lines.append(
                f"{len(self.stretched)} spots lengthened by at most {STRETCH:g} m into "
                f"the aisle to hold the car, for parked cars only: "
                f"{', '.join(self.stretched)}"
            )
        if self.outside:
            lines.append(f"outside the drivable part: {commonest(self.outside)}")
        if self.unknown:
            lines.append(f"not understood: {commonest(self.unknown)}")
        return "\n".join(lines)


@dataclasses.dataclass(frozen=True)
class Plan:
    """The features of a map, in its order."""

    features: list[Feature] = dataclasses.field(default_factory=list)
    report: Report = dataclasses.field(default_factory=Report)


def tagged(features: Iterable[Feature], *tags: str) -> list[Feature]:
    """The features with one of some tags."""
    return [one for one in features if one.tag in tags]


def lane_features(
    name: str, line: Any, width: float, one_way: bool, level: str = ""
) -> list[Feature]:
    """The straight parts of a lane with a centre line."""
    points = shapely.get_coordinates(line.simplify(BEND))
    return [
        Feature("lane", part, name, width=width, one_way=one_way, level=level)
        for part in map(shapely.LineString, itertools.pairwise(points))
        if part.length
    ]


def on_level(plan: Plan, level: str | None = None) -> Plan:
    """The part of a plan on one level: by default the one with most spots.

    Spots without a level are on the ground, level 0; all else without one is on every
    level. `ValueError` if no spot is on the level.
    """
    counts, report = Counter[str](), plan.report
    for one in [*tagged(plan.features, "bay"), *tagged(plan.features, "spots")]:
        for found in _levels(one, "0"):
            counts[found] += max(one.count, 1)
    if level is not None and counts and level not in counts:
        raise ValueError(
            f"no spot is on level {level}; there are {', '.join(sorted(counts))}"
        )
    chosen = level or max(counts, key=lambda name: counts[name], default="0")
    kept = list[Feature]()
    for one in plan.features:
        is_ground = one.tag in ("bay", "spots")
        if chosen in _levels(one, "0" if is_ground else chosen):
            kept.append(one)
        elif not is_ground:
            report.unknown[f"{one.tag} on another level"] += 1
        elif one.tag == "bay" or one.count or not one.shape.area:
            report.lost[one.name] = f"on level {one.level or 0}, not {chosen}"
    if len(counts) > 1:
        levels = ", ".join(f"{name or '?'} ({n})" for name, n in counts.most_common())
        report.notes.append(
            f"level {chosen} of these, by their spots: {levels}; see --level"
        )
    return Plan(kept, report)


def on_same_level(road: Feature, spots: Feature) -> bool:
    """Whether a road is on the level of spots; on the ground if the map says none."""
    return bool({*_levels(road, "0")} & {*_levels(spots, "0")})


def _levels(one: Feature, default: str) -> list[str]:
    return [name.strip() for name in (one.level or default).split(";")]


def first_names(names: list[str]) -> str:
    """The first names of a list, for a message."""
    return ", ".join(names[:NAMED]) + ", ..." * (len(names) > NAMED)


def commonest(counts: Counter[str]) -> str:
    """The commonest kinds with their numbers, and how many others there are."""
    named = [f"{number} {kind}" for kind, number in counts.most_common(MOST_KINDS)]
    if more := len(counts) - len(named):
        rest = counts.total() - sum(n for _, n in counts.most_common(MOST_KINDS))
        named.append(f"{rest} of {more} other kinds")
    return ", ".join(named)

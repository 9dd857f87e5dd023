"""DXF drawings: polylines, lines, circles and hatches by the names of their layers.

A word of a layer's name says what is on it, as in `A-WALL` or `Parking bays`.
"""

import itertools
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import shapely
from ezdxf import units
from ezdxf.enums import InsertUnits
from ezdxf.path import from_hatch, make_path

from carpark_formats.maps.bays import bays_between, is_bay_sized
from carpark_formats.maps.features import Feature, Plan, Tag, centred, commonest
from carpark_formats.maps.tagged import add_tagged
from carpark_mj.reading import read_bytes

_WORDS: dict[Tag, str] = {
    "bay": "bay stall spot",
    "lane": "lane aisle",
    "wall": "wall",
    "kerb": "kerb curb",
    "pillar": "pillar column cols",
    "drivable": "drivable",
    "start": "start",
}
WORDS: dict[str, Tag] = {
    word: tag for tag, words in _WORDS.items() for word in words.split()
}
PARKING = {"parking", "prkg"}  # bays, where none of `WORDS` is in the name
MOST_SHAPES = 20_000
MOST_ENTITIES = 100_000  # of blocks, each time that they are inserted
MOST_POINTS = 5_000  # of a shape
ISLAND = 6.0  # m², smaller outlines within the ground are markings
FLATNESS = 0.02  # m between a curve and its straight parts
FARTHEST = 1e8  # m from the drawing's origin, beyond any projected system
UNITS = {
    "mm": InsertUnits.Millimeters,
    "cm": InsertUnits.Centimeters,
    "m": InsertUnits.Meters,
    "in": InsertUnits.Inches,
    "ft": InsertUnits.Feet,
}

_TagOf = Callable[[str], Tag | None]


def dxf_features(path: Path, layers: Sequence[str] = (), unit: str = "") -> Plan:
    """Reads the model space of a drawing, blocks resolved; `ValueError` if it cannot.

    `layers` are `WORD=TEXT`, a word of `WORDS` for the layers whose names contain the
    text; `unit` is that of the drawing, in the place of its own.
    """
    read_bytes(path)  # refuses what is no file
    tag_of = _reading(layers)
    plan = Plan()
    try:
        drawing: Any = ezdxf.readfile(path)  # pyright: ignore[reportPrivateImportUsage]
        scale = _metres(unit, drawing.units)
        entities = _entities(drawing, tag_of, plan.report.unknown)
        shapes = _shapes(entities, scale, tag_of, plan.report.unknown)
        found = [*itertools.islice(shapes, MOST_SHAPES)]
    except _UnusableError:
        raise
    except Exception as error:  # whatever a damaged tag leads its parser to
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"no DXF that can be read ({reason})") from None
    if not found:
        known = ", ".join((*WORDS, *sorted(PARKING)))
        raise ValueError(
            f"no layer with shapes is named by one of the words {known}; --layer "
            f"stall=TEXT names another one; found: {commonest(plan.report.unknown)}"
        )
    if len(found) == MOST_SHAPES:
        raise ValueError(f"the drawing has {MOST_SHAPES} shapes or more")
    try:
        every = centred(np.concatenate([points for _, points, _ in found]))
    except ValueError as error:
        raise ValueError(f"{error}, or give its --unit") from None
    dividers: list[Any] = []
    grounds: dict[tuple[Tag, bool], list[Any]] = {}
    drawn: set[Any] = set()
    ends = np.cumsum([len(points) for _, points, _ in found])[:-1]
    for (name, _, tags), points in zip(found, np.split(every, ends), strict=True):
        # A hatch has its outline beside it.
        corners = frozenset(map(tuple, np.round(points, 2).tolist()))
        if (tags["tag"], corners) in drawn:
            continue
        drawn.add((tags["tag"], corners))
        closed = len(points) > 3 and np.ptp(points[[0, -1]], axis=0).max() < 1e-3
        shape = (shapely.Polygon if closed else shapely.LineString)(points)
        if tags["tag"] == "bay" and not (shape.area and is_bay_sized(shape)):
            dividers.append(shapely.LineString(points))
        elif tags["tag"] in ("lane", "drivable") and shape.area:
            key = tags["tag"], tags["one_way"]
            grounds.setdefault(key, []).append(shapely.make_valid(shape))
        else:
            add_tagged(plan, name, shape, tags)
    for (tag, one_way), outlines in grounds.items():
        for part in shapely.get_parts(_nested(outlines)):
            add_tagged(plan, f"{tag} ground", part, {"tag": tag, "one_way": one_way})
    _add_bays(plan, dividers)
    return plan


def _nested(outlines: list[Any]) -> Any:
    """The ground of outlines: what lies within another one is an island in it."""
    shapes = np.array(outlines, object)
    inner, outer = shapely.STRtree(shapes).query(shapes, "covered_by")
    depth = np.bincount(inner[inner != outer], minlength=len(shapes))
    ground: Any = shapely.Polygon()
    for level in range(depth.max() + 1):
        here = shapes[depth == level]
        if level % 2:  # and not an arrow on the ground
            here = here[shapely.area(here) > ISLAND]
            ground = ground.difference(shapely.union_all(here))
        else:
            ground = ground.union(shapely.union_all(here))
    return ground


def _add_bays(plan: Plan, dividers: list[Any]) -> None:
    """Adds the bays between lines, and counts the lines that bound none."""
    drawn = [one.shape for one in plan.features if one.tag == "bay"]
    found = bays_between(dividers, drawn)
    for number, shape in enumerate(found):
        plan.features.append(Feature("bay", shape, f"between lines {number + 1}"))
    bays = np.array([*drawn, *found], object)
    if idle := sum(not shapely.dwithin(line, bays, 0.1).any() for line in dividers):
        plan.report.unknown["lines of bays between which there is none"] += idle


class _UnusableError(ValueError):
    """A drawing that can be read but not used."""


def _reading(layers: Sequence[str]) -> _TagOf:
    """What is on a layer, by its name; `layers` as of `dxf_features`."""
    given: list[tuple[str, Tag]] = []
    for one in layers:
        word, _, text = one.partition("=")
        if word not in WORDS or not text:
            raise ValueError(
                f"--layer takes a word and a text of a layer's name, as in "
                f"stall=STELLPLATZ, not {one}; words: {', '.join(WORDS)}"
            )
        given.append((text.casefold(), WORDS[word]))

    def tag_of(layer: str) -> Tag | None:
        for text, tag in given:
            if text in layer.casefold():
                return tag
        words = re.findall(r"[a-z]+", layer.lower())
        names = [word if word in WORDS else word.removesuffix("s") for word in words]
        for name in names:
            if name in WORDS:
                return WORDS[name]
        return "bay" if PARKING.intersection(names) else None

    return tag_of


def _metres(name: str, own: int) -> float:
    """A drawing's unit [m]; `name` overrides its own, which is 0 for none."""
    if name and name not in UNITS:
        raise _UnusableError(f"--unit is one of {', '.join(UNITS)}, not {name}")
    own = UNITS.get(name, own)
    if not own:
        raise _UnusableError("the drawing has no unit ($INSUNITS): give its --unit")
    return units.conversion_factor(InsertUnits(own), InsertUnits.Meters)


def _entities(
    drawing: Any, tag_of: _TagOf, unknown: Counter[str]
) -> Iterator[tuple[Any, str]]:
    """Entities that can be seen, blocks resolved, and their layers.

    What a block has on layer 0 is on the block's. A block without a layer that says
    something is left as it is: plans are full of furniture and trees.
    """
    layers = (x for x in drawing.layers if x.is_off() or x.is_frozen())
    hidden = {str(layer.dxf.name) for layer in layers}
    useful: dict[tuple[str, str], bool] = {}
    seen = itertools.count()

    def is_useful(name: str, layer: str) -> bool:
        if (name, layer) not in useful:
            useful[name, layer] = False  # of a block within itself
            useful[name, layer] = any(
                is_useful(str(entity.dxf.name), own)
                if entity.dxftype() == "INSERT"
                else tag_of(own) is not None
                for entity in drawing.blocks.get(name) or ()
                for own in [_layer(entity, layer)]
            )
        return useful[name, layer]

    def walk(group: Any, layer: str) -> Iterator[tuple[Any, str]]:
        for entity in group:
            if next(seen) >= MOST_ENTITIES:
                told = f"its blocks have more than {MOST_ENTITIES} entities"
                raise _UnusableError(told)
            own = _layer(entity, layer)
            if entity.dxftype() == "INSERT":
                if not is_useful(str(entity.dxf.name), own):
                    unknown[f"INSERT on layer {own}"] += 1
                    continue
                copies = entity.multi_insert() if entity.mcount > 1 else [entity]
                for copy in copies:
                    yield from walk(copy.virtual_entities(), own)
            elif entity.dxftype() == "MLINE":
                yield from walk(entity.virtual_entities(), own)
            elif own not in hidden:
                yield entity, own

    yield from walk(drawing.modelspace(), "0")


def _layer(entity: Any, outer: str) -> str:
    own = str(entity.dxf.layer)
    return outer if own == "0" else own


def _shapes(
    entities: Iterator[tuple[Any, str]],
    scale: float,
    tag_of: _TagOf,
    unknown: Counter[str],
) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Handles, points (n, 2) [m] and tags; what has none is counted as unknown."""
    for entity, layer in entities:
        kind = f"{entity.dxftype()} on layer {layer}"
        tag = tag_of(layer)
        paths = [] if tag is None else _paths(entity)
        if not paths:
            unknown[kind] += 1
        for path in paths:
            corners = np.array([tuple(at) for at in path.control_vertices()])
            if not np.all(np.abs(corners) * scale < FARTHEST):
                raise _UnusableError(f"a {kind} lies beyond {FARTHEST:g} m")
            flat = itertools.islice(path.flattening(FLATNESS / scale), MOST_POINTS)
            points = np.array([(at.x, at.y) for at in flat]) * scale
            if not 2 <= len(points) < MOST_POINTS:
                unknown[kind] += 1
                continue
            name = " ".join(re.findall(r"[a-z]+", layer.lower()))
            one_way = "oneway" in name or "one way" in name
            tags = {"tag": tag, "width": _width(entity) * scale, "one_way": one_way}
            yield str(entity.dxf.handle), points, tags


def _paths(entity: Any) -> list[Any]:
    """The paths of an entity: none of a text, a point, a dimension."""
    kind = entity.dxftype()
    if kind in ("HATCH", "MPOLYGON"):
        return [path for path in from_hatch(entity) if len(path)]
    if kind in ("SPLINE", "HELIX") and (
        len(entity.control_points) + len(entity.fit_points) > MOST_POINTS / 10
    ):
        return []
    try:
        return [make_path(entity)]
    except TypeError:
        return []


def _width(entity: Any) -> float:
    """The constant width of a polyline, in the drawing's unit."""
    for name in ("const_width", "default_start_width"):
        if entity.dxf.is_supported(name):
            return float(entity.dxf.get(name, 0.0))
    return 0.0

"""DXF drawings: closed polylines, lines and circles by the names of their layers.

A word of a layer's name says what is on it, as in `A-WALL` or `Parking bays`.
"""

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np
import shapely
from ezdxf import units
from ezdxf.enums import InsertUnits
from ezdxf.path import make_path

from carpark_mj.maps.features import Plan, Tag
from carpark_mj.maps.frame import require_near
from carpark_mj.maps.tagged import add_tagged
from carpark_mj.reading import read_bytes

WORDS: dict[str, Tag] = {
    "bay": "bay",
    "stall": "bay",
    "spot": "bay",
    "lane": "lane",
    "aisle": "lane",
    "wall": "wall",
    "kerb": "kerb",
    "curb": "kerb",
    "pillar": "pillar",
    "column": "pillar",
    "cols": "pillar",
    "drivable": "drivable",
    "start": "start",
}
MOST_SHAPES = 20_000
FLATNESS = 0.02  # m between a curve and its straight parts
FARTHEST = 1e8  # m from the drawing's origin, beyond any projected system


def dxf_features(path: Path) -> Plan:
    """Reads the model space of a drawing, blocks resolved.

    Raises:
        ValueError: it is no DXF, has no unit, or is too large.
        OSError: the file cannot be read.
    """
    read_bytes(path)  # refuses what is no file
    plan = Plan()
    try:
        drawing: Any = ezdxf.readfile(path)  # pyright: ignore[reportPrivateImportUsage]
        unit, model = drawing.units, drawing.modelspace()
        found = [*itertools.islice(_shapes(model, _metres(unit), plan), MOST_SHAPES)]
    except _UnusableError:
        raise
    except Exception as error:  # whatever a damaged tag leads its parser to
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"no DXF that can be read ({reason})") from None
    if not found:
        known = ", ".join(WORDS)
        raise ValueError(f"no layer with shapes is named by one of the words {known}")
    if len(found) == MOST_SHAPES:
        raise ValueError(f"the drawing has {MOST_SHAPES} shapes or more")
    points = np.concatenate([points for _, points, _ in found])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    require_near(points - middle)
    for name, points, tags in found:
        closed = len(points) > 3 and np.ptp(points[[0, -1]], axis=0).max() < 1e-3
        kind = shapely.Polygon if closed else shapely.LineString
        add_tagged(plan, name, kind(points - middle), tags)
    return plan


class _UnusableError(ValueError):
    """A drawing that can be read but not used."""


def _metres(unit: int) -> float:
    """A drawing's unit [m]."""
    if not unit:
        raise _UnusableError("the drawing has no unit ($INSUNITS): save it with one")
    return units.conversion_factor(InsertUnits(unit), InsertUnits.Meters)


def _entities(group: Any, layer: str) -> Iterator[tuple[Any, str]]:
    """Entities and their layers; what a block has on layer 0 is on the block's."""
    for entity in group:
        own = str(entity.dxf.layer)
        own = layer if own == "0" else own
        if entity.dxftype() == "INSERT":
            copies = entity.multi_insert() if entity.mcount > 1 else [entity]
            for copy in copies:
                yield from _entities(copy.virtual_entities(), own)
        else:
            yield entity, own


def _shapes(
    model: Any, scale: float, plan: Plan
) -> Iterator[tuple[str, np.ndarray, dict[str, Any]]]:
    """Handles, points (n, 2) [m] and tags; what has none is counted in the plan."""
    for entity, layer in _entities(model, "0"):
        kind = entity.dxftype()
        words = re.findall(r"[a-z]+", layer.lower())
        names = [word if word in WORDS else word.removesuffix("s") for word in words]
        tag = next((WORDS[name] for name in names if name in WORDS), None)
        if tag is None:
            plan.unknown[f"{kind} on layer {layer}"] += 1
            continue
        try:
            path = make_path(entity)
        except TypeError:  # a text, a point, a dimension
            plan.unknown[f"{kind} on layer {layer}"] += 1
            continue
        corners = np.array([tuple(at) for at in path.control_vertices()])
        if not np.all(np.abs(corners) * scale < FARTHEST):
            raise _UnusableError(
                f"a {kind} on layer {layer} lies beyond {FARTHEST:g} m"
            )
        points = np.array([(at.x, at.y) for at in path.flattening(FLATNESS / scale)])
        if len(points) < 2:
            plan.unknown[f"{kind} on layer {layer}"] += 1
            continue
        width = float(entity.dxf.get("const_width", 0.0)) * scale
        one_way = "oneway" in words or "one way" in " ".join(words)
        yield (
            str(entity.dxf.handle),
            points * scale,
            {"tag": tag, "width": width, "one_way": one_way},
        )

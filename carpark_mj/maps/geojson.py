"""GeoJSON: polygons, lines and points with our tags or those of OpenStreetMap.

The property `tag` is one of `carpark_mj.maps.features.Tag`; `width` [m] and `one_way`
belong to lanes. Coordinates are longitude and latitude, or of the system that the
member `crs` names.
"""

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
import shapely
from shapely.errors import ShapelyError

from carpark_mj.maps.features import LINE_THICKNESS, Plan, Tag
from carpark_mj.maps.features import Feature as MapFeature
from carpark_mj.maps.frame import WGS84, to_metres
from carpark_mj.maps.openstreetmap import add_by_tags
from carpark_mj.reading import parse_object, read_text


def geojson_features(path: Path) -> Plan:
    """Reads a file.

    Raises:
        ValueError: not GeoJSON, or invalid coordinates.
        OSError: the file cannot be read.
    """
    data = parse_object(read_text(path), "the GeoJSON", features=list)
    rows = data["features"]
    shapes, names, properties = [], [], []
    for index, row in enumerate(rows):
        if not isinstance(row, dict) or not isinstance(
            row.get("properties") or {}, dict
        ):
            raise ValueError(f"features[{index}] must be an object with properties")
        try:
            shape = shapely.from_geojson(json.dumps(row.get("geometry")))
        except (ShapelyError, ValueError, TypeError):
            shape = None
        if shape is None or shape.is_empty:
            raise ValueError(
                f"features[{index}] must have a geometry, not "
                f"{str(row.get('geometry'))[:60]}"
            )
        for part in getattr(shape, "geoms", [shape]):
            shapes.append(shapely.force_2d(part))
            names.append(str(row.get("id", index)))
            properties.append(row.get("properties") or {})
    if not shapes:
        raise ValueError("the GeoJSON has no feature")
    placed = shapely.set_coordinates(
        np.array(shapes), to_metres(shapely.get_coordinates(shapes), _system(data))
    )
    plan = Plan()
    for name, shape, tags in zip(names, placed, properties, strict=True):
        _add(plan, name, shape, tags)
    return plan


def _system(data: dict[str, Any]) -> str:
    """The name of the coordinate reference system."""
    crs = data.get("crs")
    if crs is None:
        return WGS84
    try:
        return str(crs["properties"]["name"])
    except (TypeError, KeyError):
        raise ValueError(f"crs must have properties with a name, not {crs}") from None


def _add(plan: Plan, name: str, shape: Any, tags: dict[str, Any]) -> None:
    tag = tags.get("tag")
    if tag is None:
        add_by_tags(plan, name, tags, shape)
    elif tag not in get_args(Tag):
        plan.unknown[f"tag={tag}"] += 1
    elif tag == "lane":
        road = {"highway": "service", "width": tags.get("width")}
        road["oneway"] = "yes" if tags.get("one_way") else "no"
        add_by_tags(plan, name, road, shape)
    else:
        if not shape.area and tag in ("wall", "kerb", "pillar"):
            shape = shape.buffer(LINE_THICKNESS / 2)
        if shape.area:
            plan.features.append(MapFeature(tag, shapely.make_valid(shape), name))
        elif tag == "bay":
            plan.lost[name] = f"a {shape.geom_type.lower()}, not an area"
        else:
            plan.unknown[f"{tag} that is no area"] += 1

"""GeoJSON: polygons, lines and points with our tags or those of OpenStreetMap.

The property `tag` is one of `carpark_mj.maps.features.Tag`; `width` [m] and `one_way`
belong to lanes. Coordinates are longitude and latitude, or of the system that the
member `crs` or the flag `--crs` names.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely.errors import ShapelyError

from carpark_mj.maps.features import Plan
from carpark_mj.maps.frame import WGS84, to_metres
from carpark_mj.maps.tagged import add_tagged
from carpark_mj.reading import parse_object, read_text


def geojson_features(path: Path, crs: str | None = None) -> Plan:
    """Reads a file: a collection, one feature, or a bare geometry.

    Args:
        path: of the file.
        crs: the coordinate reference system, instead of the one in the file.

    Raises:
        ValueError: not GeoJSON, or invalid coordinates.
        OSError: the file cannot be read.
    """
    data = parse_object(read_text(path), "the GeoJSON")
    plan, shapes, names, properties = Plan(), [], [], []
    for index, row in enumerate(_rows(data)):
        if not isinstance(row, dict) or not isinstance(
            row.get("properties") or {}, dict
        ):
            raise ValueError(f"features[{index}] must be an object with properties")
        geometry = row.get("geometry")
        if geometry is None:  # RFC 7946, section 3.2: a feature without a place
            plan.unknown["feature without a geometry"] += 1
            continue
        try:
            shape = shapely.from_geojson(json.dumps(geometry))
        except (ShapelyError, ValueError, TypeError):
            raise ValueError(
                f"features[{index}] must have a geometry, not {str(geometry)[:60]}"
            ) from None
        if shape.is_empty:
            plan.unknown["feature without a geometry"] += 1
        for part in shapely.get_parts(shape):
            shapes.append(shapely.force_2d(part))
            names.append(str(row.get("id", index)))
            properties.append(row.get("properties") or {})
    if not shapes:
        raise ValueError("the GeoJSON has no feature with a geometry")
    placed = shapely.set_coordinates(
        np.array(shapes), to_metres(shapely.get_coordinates(shapes), _system(data, crs))
    )
    for name, shape, tags in zip(names, placed, properties, strict=True):
        add_tagged(plan, name, shape, tags)
    return plan


def _rows(data: dict[str, Any]) -> list[Any]:
    """The features of a collection, a feature, or a geometry."""
    if isinstance(data.get("features"), list):
        return data["features"]
    if data.get("type") == "Feature":
        return [data]
    if "coordinates" in data or "geometries" in data:
        return [{"geometry": data}]
    raise ValueError("the GeoJSON must have features, a geometry or coordinates")


def _system(data: dict[str, Any], given: str | None) -> str:
    """The name of the coordinate reference system."""
    if given is not None:
        return given
    crs = data.get("crs")
    if crs is None:
        return WGS84
    try:
        return str(crs["properties"]["name"])
    except (TypeError, KeyError):
        raise ValueError(f"crs must have properties with a name, not {crs}") from None

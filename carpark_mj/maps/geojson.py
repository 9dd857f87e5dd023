"""GeoJSON: polygons, lines and points with our tags or those of OpenStreetMap.

The property `tag` is one of `carpark_mj.maps.features.Tag`; `width` [m] and `one_way`
belong to lanes. Coordinates are longitude and latitude, or of the system that the
member `crs` names.
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
        add_tagged(plan, name, shape, tags)
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

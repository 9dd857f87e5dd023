"""From geographic or projected coordinates to metres about their middle."""

from typing import Any

import numpy as np
import pyproj
from pyproj.exceptions import ProjError

WGS84 = "EPSG:4326"
FARTHEST = 1_000.0  # m from the middle: maps of at most 2 km


def to_metres(coordinates: np.ndarray, system: str = WGS84) -> np.ndarray:
    """Projects coordinates onto a plane that touches the earth in their middle.

    Args:
        coordinates: (n, 2) in the order longitude, latitude, or east, north.
        system: the coordinate reference system, in any form that PROJ knows.

    Returns:
        (n, 2) east and north of the middle [m].

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
    require_near(xy)
    return xy


def require_near(xy: np.ndarray) -> None:
    """Refuses maps of more than 2 km.

    Raises:
        ValueError: with the size.
    """
    if not np.isfinite(xy).all():
        raise ValueError("coordinates must be finite")
    size = np.ptp(xy, axis=0)
    if size.max() > 2 * FARTHEST:
        raise ValueError(
            f"the map is {size[0] / 1e3:.3g} x {size[1] / 1e3:.3g} km; at most "
            f"{2 * FARTHEST / 1e3:g} km: cut one car park out of it"
        )

"""A layout of a map file."""

from collections.abc import Sequence
from pathlib import Path

from carpark_mj.layouts.types import Layout
from carpark_mj.maps.assemble import Report, assemble
from carpark_mj.maps.features import Plan, on_level
from carpark_mj.maps.rows import lay_out

FORMATS = (".osm", ".xml", ".geojson", ".json", ".dxf")


def import_map(
    path: Path,
    *,
    level: str | None = None,
    crs: str | None = None,
    layers: Sequence[str] = (),
    unit: str = "",
) -> tuple[Layout, Report]:
    """Reads a map: Lanelet2, OpenStreetMap, CommonRoad, GeoJSON, or DXF.

    Args:
        path: of the map.
        level: to take; by default the one with most spots.
        crs: coordinate reference system of a GeoJSON file that names none or another.
        layers: of a drawing, see `dxf.dxf_features`.
        unit: of a drawing, in the place of its own.

    Raises:
        ValueError: no such map, or no valid lot in it; the message names the file.
    """
    try:
        plan = read_plan(path, crs=crs, layers=layers, unit=unit)
        return assemble(lay_out(on_level(plan, level)))
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_plan(
    path: Path,
    *,
    crs: str | None = None,
    layers: Sequence[str] = (),
    unit: str = "",
) -> Plan:
    """The features of a map.

    Raises:
        ValueError: no such map.
        OSError: the file cannot be read.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"a map must end in one of {', '.join(FORMATS)}")
    if crs is not None and suffix not in (".geojson", ".json"):
        raise ValueError("only GeoJSON has a coordinate reference system to name")
    if suffix != ".dxf" and (layers or unit):
        raise ValueError("only drawings (.dxf) take --layer and --unit")
    if suffix in (".geojson", ".json"):
        from carpark_mj.maps.geojson import geojson_features

        return geojson_features(path, crs)
    if suffix == ".dxf":
        from carpark_mj.maps.dxf import dxf_features

        return dxf_features(path, layers, unit)
    from carpark_mj.maps.commonroad import commonroad_features
    from carpark_mj.maps.lanelet2 import is_lanelet2, lanelet2_features
    from carpark_mj.maps.openstreetmap import osm_features
    from carpark_mj.maps.osm_xml import read_osm, read_xml

    root = read_xml(path)
    if root.tag == "commonRoad":
        return commonroad_features(root)
    if root.tag != "osm":
        raise ValueError(
            f"the outermost element must be osm or commonRoad, not {root.tag}"
        )
    osm = read_osm(root)
    return lanelet2_features(osm) if is_lanelet2(osm) else osm_features(osm)

"""A layout of a map file, with a report of omitted features."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from shapely import affinity

from carpark_formats import parkbench
from carpark_formats.maps.bays import lay_out
from carpark_formats.maps.commonroad import commonroad_features
from carpark_formats.maps.features import (
    LINE_THICKNESS,
    STRETCH,
    Feature,
    Plan,
    Report,
    on_level,
    tagged,
)
from carpark_formats.maps.fit import (
    Box,
    around,
    best_fits,
    boxes,
    cut_free,
    joined_lanes,
    opened,
)
from carpark_formats.maps.osm_xml import osm_features, read_xml
from carpark_formats.maps.tagged import geojson_features
from carpark_mj.config.checks import counted
from carpark_mj.layouts import build
from carpark_mj.layouts.build import swept_size
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.standards import PLAUSIBLE_BAY, DesignCar
from carpark_mj.layouts.types import BayKind, Layout, WallKind
from carpark_mj.reading import naming_file, parse_object, read_text

FORMATS = (".osm", ".xml", ".geojson", ".json", ".dxf")
APRON = 6.0  # m of free ground around the spots of a map that has no ground
ROUNDING = 0.01  # m by which walls beside a bay may reach into the car's room
NARROW = 0.5  # m cut off the free ground, by which rectangles may reach beyond it
MOST_BAYS = 500
REACH = 1.5  # m from the drivable ground within which walls and kerbs are kept
NEAR = 4.0  # m from the drivable ground within which a spot must begin
WORST_FIT = 0.6  # m between the outlines of a spot and its rectangle
TWICE = 0.5  # share of a spot that a duplicate covers
DETAIL = 0.25  # m, smaller bends of walls are straightened
SLIVER = 0.08  # m, thinner walls are dropped
THINNEST = 0.02  # m, of a wall
LEAST_START = 0.05  # m that a start is long and wide
LEANING = 0.02  # share of a bay outside the outline of a spot that leans
NOSE = 0.3  # m to spare in a bay that is led out into the aisle
AHEAD = 1.0  # m in front of a spot, where its aisle is
ROUND = 0.75  # of a column's radius that bays must leave, for it to be a disc
MARGIN = 1.0  # m around everything
_Disc = tuple[float, float, float]


def import_map(
    path: Path,
    *,
    level: str | None = None,
    crs: str | None = None,
    layers: Sequence[str] = (),
    unit: str = "",
) -> tuple[Layout, Report]:
    """Reads a map: Lanelet2, OpenStreetMap, CommonRoad, GeoJSON, DXF, or ParkBench.

    Args:
        path: of the map.
        level: to take; by default the one with most spots.
        crs: coordinate reference system of a GeoJSON file that names none or another.
        layers: of a drawing, see `dxf.dxf_features`.
        unit: of a drawing, in the place of its own.

    Raises:
        ValueError: no such map, or no valid lot in it; the message names the file.
    """
    with naming_file(path):
        if path.suffix.lower() == ".json":
            data = parse_object(read_text(path), "the map")
            if parkbench.KEY in data:
                if level or crs or layers or unit:
                    flags = "--level, --crs, --layer and --unit"
                    raise ValueError(f"a recorded case does not take {flags}")
                return _recorded_case(data)
        plan = read_plan(path, crs=crs, layers=layers, unit=unit)
        return assemble(lay_out(on_level(plan, level)))


def _recorded_case(data: Any) -> tuple[Layout, Report]:
    layout, car = parkbench.parkbench_layout(data), parkbench.PARKBENCH_CAR
    notes = [f"a recorded case: {int(layout.wall_mask.sum())} pieces are walls"]
    if faults := describe_faults(layout, car.size):
        notes.append(f"warning: {'; '.join(faults)}")
    return layout, Report(notes=notes)


def read_plan(
    path: Path, *, crs: str | None = None, layers: Sequence[str] = (), unit: str = ""
) -> Plan:
    """The features of a map; see `import_map`, but errors do not name the file."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"a map must end in one of {', '.join(FORMATS)}")
    if crs is not None and suffix not in (".geojson", ".json"):
        raise ValueError("only GeoJSON has a coordinate reference system to name")
    if suffix != ".dxf" and (layers or unit):
        raise ValueError("only drawings (.dxf) take --layer and --unit")
    if suffix in (".geojson", ".json"):
        return geojson_features(path, crs)
    if suffix == ".dxf":
        from carpark_formats.maps.dxf import dxf_features  # needs ezdxf

        return dxf_features(path, layers, unit)
    root = read_xml(path)
    if root.tag == "commonRoad":
        return commonroad_features(root)
    if root.tag == "osm":
        return osm_features(root)
    raise ValueError(f"the outermost element must be osm or commonRoad, not {root.tag}")


def assemble(plan: Plan) -> tuple[Layout, Report]:
    """Makes a layout of a map, its middle at the origin and its rows along x or y.

    Raises:
        ValueError: no spot can be a bay, there are too many, or nowhere is room to
            start.
    """
    report, count = plan.report, len(tagged(plan.features, "bay"))
    report.spots = count + len(report.lost)
    if not count:
        raise ValueError(f"the map has no parking spot{_reasons(report)}")
    if count > MOST_BAYS:
        raise ValueError(f"the map has {count} spots; at most {MOST_BAYS}")
    features = _turned(plan.features, report)
    spots = tagged(features, "bay")
    drivable = shapely.union_all(
        [_ground(one) for one in tagged(features, "lane", "drivable", "start")]
    )
    if drivable.is_empty:
        hull = shapely.union_all([one.shape for one in spots]).convex_hull
        drivable = hull.buffer(APRON, join_style="mitre")
        report.notes.append("the map has no ground to drive on: taken around its spots")
    roads = tagged(features, "lane")
    bays = _bays(spots, roads, drivable, report)
    if not bays:
        raise ValueError(f"no spot of the map can be a bay{_reasons(report)}")
    taken = [box.shape for box, _ in bays]
    ground = shapely.union_all([drivable, *taken])
    solids, discs = _solids(features, ground, taken, report)
    standing = [box.shape for box, _ in solids]
    standing += [shapely.Point(x, y).buffer(r) for x, y, r in discs]
    lanes = []
    tree = shapely.STRtree([*taken, *standing])
    for lane, one_way in joined_lanes(roads):
        free = cut_free(lane, _met(tree, lane))
        if free and free.length > 2.0 and free.width > 1.0:
            lanes.append((free, one_way))
        else:
            report.outside["lane without room"] += 1
    starts = [_start(one) for one in tagged(features, "start")]
    starts += [lane for lane, _ in lanes]
    starts += [lane.turned() for lane, one_way in lanes if not one_way]
    starts = [box for box in starts if _room(box).min() > LEAST_START]
    if not starts:
        free = free_starts(drivable, [*taken, *standing])
        free = [box for box in free if _room(box).min() > LEAST_START]
        starts = [turned for box in free for turned in (box, box.turned())]
        why = "no lane has room for a car" if lanes else "the map has no lane"
        report.notes.append(f"{why}: cars start on free ground")
    if not starts:
        raise ValueError("the map has no room for a car to start in")
    if closed := walled_off([box for box, _ in bays], starts, standing):
        report.notes.append(
            f"warning: walls keep cars that start in the lot from {len(closed)} of "
            f"{counted(len(bays), 'bay')}"
        )
    layout, middle = _layout(bays, solids, discs, lanes, starts)
    report.shift = report.shift * np.exp(1j * report.turned) - complex(*middle)
    if faults := describe_faults(layout):
        raise ValueError(f"the map gives no valid layout: {'; '.join(faults)}")
    return layout, report


def _reasons(report: Report) -> str:
    """Why spots were left out, in brackets; empty if none was."""
    reasons = "; ".join(sorted(set(report.lost.values()))[:3])
    return f" ({reasons})" if reasons else ""


def _ground(feature: Feature) -> Any:
    if feature.tag != "lane":
        return feature.shape
    return feature.shape.buffer(feature.width / 2, cap_style="square")


def _start(feature: Feature) -> Box:
    """The rectangle around a start, in its heading."""
    box = around(feature.shape)
    against = feature.yaw is not None and np.cos(box.yaw - feature.yaw) < 0
    return box.turned() if against else box


def _met(tree: Any, box: Box) -> Any:
    """The shapes of a tree that a rectangle meets."""
    return tree.geometries[tree.query(box.shape, "intersects")]


def _room(box: Box) -> np.ndarray:
    """Length and width (2,) in which the centre of a starting car may lie [m]."""
    return np.subtract(box.size, swept_size(DesignCar()))


def _turned(features: list[Feature], report: Report) -> list[Feature]:
    """Turns the map so that most of its bays lie along x or y."""
    yaws = np.array([around(one.shape).yaw for one in tagged(features, "bay")])
    report.turned = -float(np.angle(np.exp(4j * yaws).sum())) / 4
    found = []
    for one in features:
        shape = affinity.rotate(one.shape, report.turned, (0, 0), use_radians=True)
        yaw = None if one.yaw is None else one.yaw + report.turned
        found.append(dataclasses.replace(one, shape=shape, yaw=yaw))
    return found


def _bays(
    spots: list[Feature], roads: list[Feature], drivable: Any, report: Report
) -> list[tuple[Box, BayKind]]:
    """Rectangles of the spots, heading out into the aisle."""
    least = DesignCar().size
    near = drivable.buffer(NEAR)
    shapes = [one.shape for one in spots]
    ways = shapely.union_all([one.shape for one in roads])
    # Without strips that are too narrow for a car, as between two rows.
    half = least[1] / 2
    open_ground = drivable.difference(shapely.union_all(shapes)).buffer(-half)
    open_ground = open_ground.buffer(half, join_style="mitre")
    goals = [part for part in (open_ground, ways) if not part.is_empty]
    tree = shapely.STRtree(shapes)
    found: list[tuple[Box, BayKind]] = []
    taken: list[Any] = []
    for one in spots:
        fits = best_fits(one.shape)
        ahead = found[-1][0].yaw if found else 0
        box = _facing([box for box, _ in fits], goals, ahead)
        short = box.length < least[0] < box.length + STRETCH
        if short:  # what stands behind it stays
            back = -box.length / 2
            box = box.part(back, back + least[0] + 0.01)
        others = [other for other in taken if other.intersects(box.shape)]
        common = [other.intersection(box.shape).area for other in others]
        free = cut_free(box, others)
        if box.shape.difference(one.shape).area > LEANING * box.shape.area:
            # It leans: it ends at the spots behind it, and a car's nose stands out.
            met = [shapes[k] for k in tree.query(box.shape)]
            met = [shape for shape in met if shape is not one.shape]
            free = _led_out(cut_free(box, [*met, *others]), box, others)
        long, wide = free.size if free else (0.0, 0.0)
        if (error := fits[0][1]) > WORST_FIT:
            lost = f"no rectangle: {error:.2f} m off the best one"
        elif not one.shape.intersects(near):
            lost = f"more than {NEAR:g} m from what can be driven on"
        elif max(common, default=0.0) > TWICE * one.shape.area:
            lost = "covered by another spot"
        elif free is None or long < least[0] or wide < least[1]:
            car = f"{least[0]:g} x {least[1]:g} m"
            lost = f"smaller than the car of {car}: {long:.2f} x {wide:.2f} m"
        elif max(long, wide) > PLAUSIBLE_BAY[1]:
            lost = f"longer than {PLAUSIBLE_BAY[1]:g} m: {long:.1f} m"
        else:
            error = shapely.hausdorff_distance(one.shape, free.shape)
            report.errors.append(float(error))
            if short:
                report.stretched.append(one.name)
            taken.append(free.shape)
            found.append((free, BayKind.RESERVED if short else one.kind))
            continue
        report.lost[one.name] = lost
    return found


def _led_out(free: Box | None, box: Box, others: list[Any]) -> Box | None:
    """What is left of a rectangle, lengthened in front to hold the car again."""
    length = min(box.length, DesignCar().length + NOSE)
    if free is None or free.length >= length:
        return free
    back = -free.length / 2
    return cut_free(free.part(back, back + length), others)


def _facing(found: list[Box], goals: list[Any], yaw: float) -> Box:
    """The rectangle, and its end in front, that leads to the goals, else to `yaw`."""

    def away(box: Box) -> list[float]:
        reach = box.length / 2 + AHEAD
        x, y = box.x + reach * np.cos(box.yaw), box.y + reach * np.sin(box.yaw)
        # Less than a decimetre is no difference between the ends of a spot.
        gaps = [round(goal.distance(shapely.Point(x, y)), 1) for goal in goals]
        return [*gaps, -round(float(np.cos(box.yaw - yaw)), 3)]

    return min([turned for box in found for turned in (box, box.turned())], key=away)


def _solids(
    features: list[Feature], ground: Any, taken: list[Any], report: Report
) -> tuple[list[tuple[Box, WallKind]], list[_Disc]]:
    """Boxes and discs of walls, kerbs and columns within reach of the ground."""
    within = ground.buffer(REACH, join_style="mitre")
    occupied = shapely.union_all(taken).buffer(0.001)
    tree = shapely.STRtree(taken)
    kept: dict[WallKind, list[Any]] = {WallKind.WALL: [], WallKind.KERB: []}
    discs: list[_Disc] = []
    for one in tagged(features, "wall", "kerb", "pillar"):
        shape = one.shape
        if one.tag != "pillar":
            if len(tree.query(shape, "contains")):
                # What stands around spots is drawn by its outline.
                shape = shape.boundary.buffer(LINE_THICKNESS / 2)
                report.notes.append(f"{one.tag} {one.name} is an outline around spots")
            for road in tagged(features, "lane"):
                if len(shapely.get_parts(road.shape.difference(shape))) > 1:
                    way = road.shape.intersection(shape)
                    shape = shape.difference(way.buffer(road.width / 2))
        shape = shape.intersection(within)
        if shape.is_empty:
            report.outside[one.tag] += 1
            continue
        radius = float(np.sqrt(one.shape.area / np.pi))
        room = one.shape.centroid.distance(occupied)
        if one.tag == "pillar" and room > ROUND * radius:
            x, y = one.shape.centroid.coords[0]
            discs.append((x, y, min(radius, room)))
        else:
            kind = WallKind.KERB if one.tag == "kerb" else WallKind.WALL
            kept[kind].append(shape)
    solids = list[tuple[Box, WallKind]]()
    for kind, shapes in kept.items():
        closed = opened(shapely.union_all(shapes), -DETAIL).difference(occupied)
        parts = shapely.get_parts(opened(closed, SLIVER))  # without gaps between bays
        parts = parts[shapely.area(parts) > 0]
        # No more than a quarter of a thin wall's thickness.
        thickness = 2 * shapely.area(parts) / shapely.length(parts)
        parts = shapely.simplify(parts, np.minimum(DETAIL, thickness / 4))
        for box in itertools.chain.from_iterable(map(boxes, parts)):
            free = cut_free(box, _met(tree, box))
            if free and free.width > THINNEST and free.length > DETAIL:
                solids.append((free, kind))
    return solids, discs


def _layout(
    bays: list[tuple[Box, BayKind]],
    solids: list[tuple[Box, WallKind]],
    discs: list[_Disc],
    lanes: list[tuple[Box, bool]],
    starts: list[Box],
) -> tuple[Layout, np.ndarray]:
    """The layout, and the place that became its origin (2,)."""
    shapes = [box.shape for box, _ in (*bays, *solids, *lanes)]
    left, low, right, high = shapely.union_all(shapes).bounds
    middle = np.array([(left + right) / 2, (low + high) / 2, 0.0])
    extent = np.array([right - left, high - low]) / 2 + MARGIN

    def rows(found: Any, part: str, dtype: type) -> dict[str, np.ndarray]:
        pose = np.array([box.pose for box, _ in found]).reshape(-1, 3) - middle
        size = np.array([box.size for box, _ in found]).reshape(-1, 2)
        values = np.array([value for _, value in found], dtype)
        return {"pose": pose, "size": size, part: values}

    regions = rows([(box, build.LANE_SPREAD) for box in starts], "spread", float)
    columns = np.array(discs).reshape(-1, 3)
    layout = build.from_columns(
        extent,
        {
            "bays": rows(bays, "kind", int),
            "walls": rows(solids, "kind", int),
            "discs": {"centre": columns[:, :2] - middle[:2], "radius": columns[:, 2]},
            "lanes": rows(lanes, "one_way", bool),
            "spawns": regions | {"size": np.array([_room(box) for box in starts])},
        },
    )
    return layout, middle[:2]


def free_starts(ground: Any, taken: Sequence[Any]) -> list[Box]:
    """Rectangles in the ground, clear of `taken` shapes, that a car has room for."""
    free = ground.difference(shapely.union_all(taken)).buffer(-NARROW)
    tree, found = shapely.STRtree(taken), []
    for box in boxes(free):
        if clear := cut_free(box, _met(tree, box)):
            x, y, yaw = clear.pose
            across = Box(x, y, yaw + np.pi / 2, clear.width, clear.length)
            found.append(clear if clear.length >= clear.width else across)
    return found


def walled_off(
    bays: Sequence[Box], starts: Sequence[Box], solids: Sequence[Any]
) -> list[int]:
    """Indices of the bays that no start has a way to between solids.

    A necessary test: a disc as wide as the car passes wherever cars do, but not the
    other way round.
    """
    radius = DesignCar().width / 2 - ROUNDING
    grown = shapely.union_all([solid.buffer(radius) for solid in solids])
    places = [shapely.Point(box.x, box.y) for box in (*bays, *starts)]
    whole = shapely.box(*shapely.total_bounds([grown, *places])).buffer(1.0)
    tree = shapely.STRtree(shapely.get_parts(whole.difference(grown)))
    parts = [set(tree.query(place, "intersects").tolist()) for place in places]
    reached = set[int]().union(*parts[len(bays) :])
    return [k for k, part in enumerate(parts[: len(bays)]) if not part & reached]

"""CommonRoad scenarios, version 2020a: lanelets, static obstacles, planning problems.

`commonroad-io` reads them too, but needs a protobuf that `onnx` cannot use.
"""

import dataclasses
from typing import Any

import numpy as np
import shapely
from shapely import affinity

from carpark_formats.maps.features import Feature, Plan, Tag, centred
from carpark_formats.maps.fit import Box
from carpark_formats.maps.osm_xml import add_lanelet, read_number
from carpark_mj.layouts.build import swept_size
from carpark_mj.layouts.standards import DesignCar

# Types of static obstacles that are not walls, as everything else that stands is.
_TAGS: dict[str, Tag] = {
    "pillar": "pillar",
    "roadBoundary": "kerb",
    "medianStrip": "kerb",
    "median_strip": "kerb",
}
_FARTHEST = 1e8  # m, of a coordinate: beyond it shapes would be rounded to nothing
_ROOM = 0.1  # m around a car at its start
_SKIPPED = ("location", "scenarioTags")


def commonroad_features(root: Any) -> Plan:
    """The features of a scenario, an element `commonRoad`; goals are spots."""
    plan = Plan()
    for element in root:
        name = element.get("id", "")
        if element.tag == "lanelet":
            sides = ((s, _points(element.find(f"{s}Bound"))) for s in ("left", "right"))
            borders = {side: points for side, points in sides if len(points) > 1}
            one_way = element.find("userBidirectional") is None
            add_lanelet(plan, name, borders, one_way)
        elif element.tag in ("staticObstacle", "environmentObstacle"):
            _add_obstacle(plan, name, element)
        elif element.tag == "planningProblem":
            _add_problem(plan, name, element)
        elif element.tag not in _SKIPPED:
            plan.report.unknown[element.tag] += 1
    if plan.features:
        shapes = np.array([one.shape for one in plan.features])
        drawn = shapely.get_coordinates(shapes)
        xy = centred(drawn)
        plan.report.shift = complex(*(xy[0] - drawn[0]))
        moved = zip(plan.features, shapely.set_coordinates(shapes, xy), strict=True)
        plan.features[:] = [dataclasses.replace(one, shape=x) for one, x in moved]
    return plan


def _add_obstacle(plan: Plan, name: str, element: Any) -> None:
    kind = element.findtext("type", "").strip()
    # The shape of an `environmentObstacle` has a place of its own.
    has_state = element.tag == "staticObstacle"
    pose = state_pose(element.find("initialState")) if has_state else (0.0, 0.0, 0.0)
    shapes = shapes_in(element.find("shape"))
    if pose is None or not shapes:
        plan.report.unknown[f"{element.tag} {kind} without an outline and a pose"] += 1
        return
    x, y, yaw = pose
    for shape in shapes:
        turned = affinity.rotate(shape, yaw, origin=(0, 0), use_radians=True)
        tag = _TAGS.get(kind, "wall")
        plan.features.append(Feature(tag, affinity.translate(turned, x, y), name))


def _add_problem(plan: Plan, name: str, element: Any) -> None:
    """The start and the goals of a car."""
    pose = state_pose(element.find("initialState"))
    if pose is None:
        plan.report.unknown["initialState without a pose"] += 1
    else:
        length, width = swept_size(DesignCar())
        start = Box(*pose, length + 2 * _ROOM, width + 2 * _ROOM)
        plan.features.append(Feature("start", start.shape, name, yaw=pose[2]))
    seen: set[str] = set()  # two states of an area are two headings in one bay
    for k, position in enumerate(element.iterfind("goalState/position")):
        goal = f"{name}.{k}" if k else name
        shapes = shapes_in(position)
        if not shapes:
            plan.report.lost[goal] = "its goal has no outline"
        new = {shape.wkt: shape for shape in shapes if shape.wkt not in seen}
        seen |= {*new}
        plan.features.extend(Feature("bay", shape, goal) for shape in new.values())


def state_pose(state: Any) -> tuple[float, float, float] | None:
    """Position and heading of a state; the middle of an interval."""
    point = None if state is None else state.find("position/point")
    heading = None if state is None else state.find("orientation")
    if point is None or heading is None:
        return None
    yaws = [number_of(part, "orientation") for part in heading]
    return (*_point(point), sum(yaws) / len(yaws)) if yaws else None


def shapes_in(parent: Any) -> list[Any]:
    """Shapely polygons of the rectangles, circles and polygons in an element."""
    shapes = []
    for element in () if parent is None else parent:
        centre = element.find("center")
        x, y = (0.0, 0.0) if centre is None else _point(centre)
        if element.tag == "rectangle":
            size = [number_of(element.find(side), side) for side in ("length", "width")]
            turn = element.find("orientation")
            yaw = 0.0 if turn is None else number_of(turn, "orientation")
            shape = Box(x, y, yaw, *size).shape
        elif element.tag == "circle":
            radius = number_of(element.find("radius"), "radius")
            shape = shapely.Point(x, y).buffer(radius)
        elif element.tag == "polygon" and len(points := _points(element)) > 2:
            shape = shapely.make_valid(shapely.Polygon(points))
        else:
            continue
        if shape.area:
            shapes.append(shape)
    return shapes


def _points(element: Any) -> np.ndarray:
    """The points (n, 2) of a border or polygon, none of them twice in a row."""
    points = [] if element is None else [_point(one) for one in element.iter("point")]
    steps = [p for p, last in zip(points, [None, *points], strict=False) if p != last]
    return np.array(steps).reshape(-1, 2)


def _point(element: Any) -> tuple[float, float]:
    return number_of(element.find("x"), "x"), number_of(element.find("y"), "y")


def number_of(element: Any, what: str) -> float:
    """The number in an element; ValueError names what it is."""
    return read_number(None if element is None else element.text or "", what, _FARTHEST)

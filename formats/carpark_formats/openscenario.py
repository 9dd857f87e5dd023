"""Scenarios as OpenSCENARIO XML 1.2, and from files of 1.x.

Written and read: entities with their boxes, `TeleportAction` and speeds of `Init`, the
goal as `AcquirePositionAction`, and for each mover an event with a start trigger and a
`FollowTrajectoryAction` along a polyline with times. Read besides: `SpeedAction` of an
event, straight on for `FAR`, and `$parameters`. Triggers are simulation time and the
euclidean or longitudinal distance of a mover to `ego`. Positions are `WorldPosition`.

An entity's origin is the middle of its footprint, with the axles about it: distances of
triggers are then ours. Read files may have another origin, as the rear axle.

Not in a written file: rule, repetitions, spreads, settings, `yields`, and which end
goes in first; slowing and return are parts of the polyline. What a read file has
besides is named in its notes.
"""

import dataclasses
import itertools
import math
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import jax
import numpy as np

from carpark_formats.maps.exporting import xml_text
from carpark_formats.maps.osm_xml import read_number, read_xml
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.scripted import Scripted
from carpark_mj.suite.actors import SIZES
from carpark_mj.suite.scenario import Scenario
from carpark_mj.vehicle import preset

EGO = "ego"
FAR = 100.0  # m, the way of a mover that only has a speed
SAMPLE = 0.01  # s between poses of which a polyline is made
DWELL = 1e-3  # m, the way of a stop, and off a straight line (or rad)
# Mass [kg] and height [m] that the format requires [est].
BODIES = {"person": (75.0, 1.75), "cart": (30.0, 1.0)}
_PEDESTRIANS = {"pedestrian": "person", "wheelchair": "cart", "animal": "person"}
_CATEGORY = {"person": "pedestrian", "cart": "wheelchair"}

_FILE = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" author="carpark_mj"
 date="2000-01-01T00:00:00" description="a parking scenario"/><CatalogLocations/>
<RoadNetwork><LogicFile filepath={lot}/></RoadNetwork><Entities>{entities}</Entities>
<Storyboard><Init><Actions>{init}</Actions></Init>{story}
<StopTrigger>{stop}</StopTrigger></Storyboard></OpenSCENARIO>"""
_BOX = """<BoundingBox><Center x="0" y="0" z="{middle}"/><Dimensions height="{height}"
 length="{size[0]:.6f}" width="{size[1]:.6f}"/></BoundingBox>"""
_WALKER = """<ScenarioObject name="{name}"><Pedestrian name="{kind}" mass="{mass}"
 pedestrianCategory="{category}">{box}<Properties/></Pedestrian></ScenarioObject>"""
_CAR = """<ScenarioObject name="{name}"><Vehicle name={kind} mass="{car.mass}"
 vehicleCategory="car">{box}<Performance maxSpeed="{car.max_speed}"
 maxAcceleration="{car.max_acceleration}" maxDeceleration="{car.max_deceleration}"/>
<Axles>{axles}</Axles><Properties/></Vehicle></ScenarioObject>"""
_AXLE = """<{name} positionX="{x}" positionZ="{car.wheel_radius}" maxSteering="{turn}"
 wheelDiameter="{diameter}" trackWidth="{car.track_width}"/>"""
_POSITION = """<Position><WorldPosition x="{0:.6f}" y="{1:.6f}" z="0" h="{2:.6f}"/>
</Position>"""
_PRIVATE = """<Private entityRef="{name}"><PrivateAction><TeleportAction>{pose}
</TeleportAction></PrivateAction>{more}</Private>"""
_SPEED = """<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics
 value="0" dynamicsShape="step" dynamicsDimension="time"/><SpeedActionTarget>
<AbsoluteTargetSpeed value="{}"/></SpeedActionTarget></SpeedAction></LongitudinalAction>
</PrivateAction>"""
_GOAL = """<PrivateAction><RoutingAction><AcquirePositionAction>{}
</AcquirePositionAction></RoutingAction></PrivateAction>"""
_STORY = """<Story name="movers"><Act name="act">{groups}<StartTrigger>{begin}
</StartTrigger></Act></Story>"""
_EVENT = """<ManeuverGroup name="{name}" maximumExecutionCount="1"><Actors
 selectTriggeringEntities="false"><EntityRef entityRef="{name}"/></Actors>
<Maneuver name="{name}"><Event name="{name}" priority="override"><Action name="{name}">
<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef>
<Trajectory name="{name}" closed="false"><Shape><Polyline>{vertices}</Polyline></Shape>
</Trajectory></TrajectoryRef><TimeReference><Timing domainAbsoluteRelative="relative"
 offset="0" scale="1"/></TimeReference><TrajectoryFollowingMode
 followingMode="position"/></FollowTrajectoryAction></RoutingAction></PrivateAction>
</Action><StartTrigger>{triggers}</StartTrigger></Event></Maneuver></ManeuverGroup>"""
_CONDITION = """<ConditionGroup><Condition name="{}" delay="0" conditionEdge="none">{}
</Condition></ConditionGroup>"""
_AFTER = """<ByValueCondition><SimulationTimeCondition rule="greaterOrEqual"
 value="{}"/></ByValueCondition>"""
_DISTANCE = """<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">
<EntityRef entityRef="ego"/></TriggeringEntities><EntityCondition>
<RelativeDistanceCondition entityRef="{name}" value="{value}" rule="lessThan"
 relativeDistanceType="{kind}" coordinateSystem="entity" freespace="false"/>
</EntityCondition></ByEntityCondition>"""
_NEAR, _AHEAD = "euclidianDistance", "longitudinal"


def openscenario_text(scenario: Scenario, map_file: str) -> str:
    """A scenario as OpenSCENARIO XML, in the map of a file."""
    layout, spots = scenario.layout, np.asarray(scenario.layout.parked_pose)
    entities, init, groups = list[str](), list[str](), list[str]()

    def add(name: str, body: str, pose: Any, more: str = "") -> None:
        entities.append(body)
        place = _POSITION.format(*pose)
        init.append(_PRIVATE.format(name=name, pose=place, more=more))

    more = _SPEED.format(scenario.speed) if scenario.speed else ""
    more += _GOAL.format(_POSITION.format(*spots[scenario.goal_bay]))
    add(EGO, _car(EGO, scenario.vehicle), scenario.start, more)
    for bay in scenario.parked:
        add(f"parked_{bay}", _car(f"parked_{bay}", scenario.vehicle), spots[bay])
    movers = zip(scenario.movers, scenario.scripts, strict=True)
    for number, (actor, script) in enumerate(movers):
        name = f"mover_{number}"
        if actor.kind == "car":
            body = _car(name, "compact", script.size)
        else:
            mass, height = BODIES[actor.kind]
            box = _BOX.format(size=script.size, height=height, middle=height / 2)
            what = {"category": _CATEGORY[actor.kind], "kind": actor.kind}
            body = _WALKER.format(name=name, mass=mass, box=box, **what)
        add(name, body, script.start)
        what = [
            _DISTANCE.format(name=name, value=value, kind=kind)
            for kind, value in ((_NEAR, script.near), (_AHEAD, script.trigger))
            if value
        ] + [_AFTER.format(time) for time in [script.after] if time is not None]
        vertices = "".join(
            f'<Vertex time="{time:.6f}">{_POSITION.format(*pose)}</Vertex>'
            for time, *pose in timeline(script, layout, scenario.seconds)
        )
        made = {"name": name, "vertices": vertices}
        made["triggers"] = "".join(_CONDITION.format(name, one) for one in what)
        groups += [_EVENT.format(**made)] * bool(what)
    begin = _CONDITION.format("begin", _AFTER.format(0))
    story = _STORY.format(groups="".join(groups), begin=begin) * bool(groups)
    parts = {"entities": "".join(entities), "init": "".join(init), "story": story}
    stop = _CONDITION.format("end", _AFTER.format(scenario.seconds))
    return xml_text(_FILE.format(lot=quoteattr(map_file), stop=stop, **parts))


def _car(name: str, vehicle: str, size: Any = None) -> str:
    car = preset(vehicle)
    size = (car.length, car.width) if size is None else size
    box = _BOX.format(size=size, height=car.height, middle=car.height / 2)
    front, rear = car.wheelbase - car.centre_offset, -car.centre_offset
    axles = "".join(
        _AXLE.format(name=axle, x=x, turn=turn, car=car, diameter=2 * car.wheel_radius)
        for axle, x, turn in (
            ("FrontAxle", front, car.max_steering),
            ("RearAxle", rear, 0),
        )
    )
    kind = quoteattr(Path(vehicle).stem)
    return _CAR.format(name=name, kind=kind, box=box, car=car, axles=axles)


def timeline(script: Scripted, layout: Layout, seconds: float) -> np.ndarray:
    """(n, 4) times since a script set out [s] and poses [m, m, rad] on its way."""
    state = script.init(jax.random.key(0), layout)
    times = np.arange(0.0, seconds + SAMPLE, SAMPLE, dtype=np.float32)
    place = jax.vmap(lambda clock: dataclasses.replace(state, clock=clock).pose)
    rows = np.column_stack([times, np.asarray(place(times))])
    moves = np.flatnonzero((np.abs(rows[:, 1:] - rows[-1, 1:]) > 1e-6).any(axis=1))
    return _without_lines(rows[: moves.max(initial=-1) + 2])


def actor_of(rows: np.ndarray, **entries: Any) -> dict[str, Any]:
    """A mover's entries that drive through times and poses (n, 4), see `timeline`."""
    turn = np.array([math.cos(rows[0, 3]), math.sin(rows[0, 3])])
    xy: list[np.ndarray] = [rows[0, 1:3]]
    path: list[list[float]] = []
    rows = _without_lines(rows)
    for (time, *_), (end, x, y, yaw) in itertools.pairwise(rows):
        to = np.array([x, y])
        if end <= time:
            continue
        if (length := math.dist(xy[-1], to)) < DWELL:
            # A stop is a tiny step on.
            to, length = xy[-1] + DWELL * turn, DWELL
        turn = (to - xy[-1]) / length
        xy.append(to)
        path.append([*to.tolist(), length / (end - time), float(yaw)])
    entries |= {"start": xy[0].tolist()}
    if math.dist(*rows[[0, -1], 1:3]) < DWELL and len(path) < 2:
        return entries | {"heading": float(rows[0, 3])}
    if len(path) == 1:
        (x, y), yaw = xy[1] - xy[0], rows[0, 3]
        behind = math.cos(yaw) * x + math.sin(yaw) * y < 0.0
        entries |= {"backwards": True} if behind else {}
        return entries | {"to": path[0][:2], "speed": path[0][2]}
    if entries.get("kind") == "person":  # a disc
        return entries | {"path": [row[:3] for row in path]}
    return entries | {"heading": float(rows[0, 3]), "path": path}


def _without_lines(rows: np.ndarray) -> np.ndarray:
    """Rows (n, 4) without those that lie between others within `DWELL`."""
    kept = [0]
    for last in range(2, len(rows)):
        ends = rows[[kept[-1], last]]
        inner = rows[kept[-1] + 1 : last]
        line = [np.interp(inner[:, 0], ends[:, 0], column) for column in ends[:, 1:].T]
        if np.abs(np.transpose(line) - inner[:, 1:]).max() > DWELL:
            kept.append(last - 1)
    return rows[[*kept, len(rows) - 1]]


def read_openscenario(path: Path) -> tuple[dict[str, Any], list[str]]:
    """Entries of a scenario without `lot`, see `make_scenario`, and notes.

    Entities that stand are movers without a way; the first vehicle, or that called
    `ego` in any case, is the car.
    """
    root = read_xml(path)
    if root.tag != "OpenSCENARIO":
        raise ValueError(f"the outermost element must be OpenSCENARIO, not {root.tag}")
    for parameter in root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        name, value = f"${parameter.get('name')}", parameter.get("value", "")
        for one in root.iter():
            one.attrib |= {key: value for key, text in one.items() if text == name}
    notes: list[str] = []
    bodies = {one.get("name"): one for one in root.iterfind("Entities/ScenarioObject")}
    cars = [name for name, body in bodies.items() if body.find("Vehicle") is not None]
    ego = next((name for name in cars if name.lower() == EGO), (*cars, "")[0])
    found: dict[str, Any] = {"movers": []}
    private = root.iterfind("Storyboard/Init/Actions/Private")
    starts = {one.get("entityRef"): one for one in private}
    events = {
        reference.get("entityRef"): group
        for group in root.iterfind("Storyboard/Story/Act/ManeuverGroup")
        for reference in group.iterfind("Actors/EntityRef")
    }
    for name, body in bodies.items():
        begin = starts.get(name)
        if begin is None or (teleport := begin.find(".//TeleportAction")) is None:
            notes.append(f"{name} has no TeleportAction: left out")
            continue
        kind, size, offset = _body(body)
        pose = _pose(teleport, name)
        pose[:2] += offset * np.array([math.cos(pose[2]), math.sin(pose[2])])
        target = begin.find(".//AbsoluteTargetSpeed")
        speed = 0.0 if target is None else _value(target, "value")
        if name == ego:
            found |= {"start": pose.tolist()} | ({"speed": speed} if speed else {})
            if (goal := begin.find(".//AcquirePositionAction")) is not None:
                found["goal"] = {"pose": _pose(goal, "the goal").tolist()}
            continue
        rows, triggers = _straight(pose, speed), {}
        if (group := events.get(name)) is not None:
            rows, triggers = _way(group, rows, ego, notes)
        mover = actor_of(rows, kind=kind, size=size, yields=False)
        found["movers"].append(mover | (triggers if {*mover} & {"to", "path"} else {}))
    if "start" not in found:
        raise ValueError("no vehicle has a start: a Vehicle with a TeleportAction")
    stop = root.find("Storyboard/StopTrigger//SimulationTimeCondition")
    if stop is not None:
        found["seconds"] = _value(stop, "value")
    return found, notes


def _body(body: Any) -> tuple[str, list[float], float]:
    """Kind, size and how far ahead of its origin the middle of an entity is."""
    what = body[0]
    kind = "car" if what.tag == "Vehicle" else "cart"
    kind = _PEDESTRIANS.get(what.get("pedestrianCategory", ""), kind)
    if (box := what.find("BoundingBox")) is None:  # of a catalogue
        return kind, list(SIZES[kind]), 0.0
    size = [_value(box.find("Dimensions"), side) for side in ("length", "width")]
    size = [max(size)] * 2 if kind == "person" else size  # a disc
    return kind, size, _value(box.find("Center"), "x")


def _way(
    group: Any, rows: np.ndarray, ego: str, notes: list[str]
) -> tuple[np.ndarray, dict[str, float]]:
    """The way of an entity's first event that moves it, and its triggers."""
    for event in group.iter("Event"):
        vertices = list(event.iter("Vertex"))
        target = event.find(".//SpeedAction//AbsoluteTargetSpeed")
        if vertices:
            poses = [_pose(vertex, "a vertex") for vertex in vertices]
            times = np.array([_value(vertex, "time") for vertex in vertices])
            rows = np.column_stack([times - times[0], poses])
        elif target is not None and (speed := _value(target, "value")):
            rows = _straight(rows[0, 1:], speed)
        else:
            notes.append(f"event {event.get('name')} has no polyline and no speed")
            continue
        return rows, _triggers(event, ego, notes)
    return rows, {}


def _triggers(event: Any, ego: str, notes: list[str]) -> dict[str, float]:
    found: dict[str, float] = {}
    for condition in event.iterfind("StartTrigger/ConditionGroup/Condition"):
        name = condition.get("name")
        time = condition.find(".//SimulationTimeCondition")
        distance = condition.find(".//RelativeDistanceCondition")
        refs = {one.get("entityRef") for one in condition.iter()}
        if time is not None:
            found["after"] = _value(time, "value")
        elif distance is not None and ego in refs:
            is_ahead = distance.get("relativeDistanceType") == _AHEAD
            found["ahead" if is_ahead else "near"] = _value(distance, "value")
            if distance.get("freespace") == "true":
                notes.append(f"condition {name}: distances are of centres here")
        else:
            notes.append(f"condition {name} is not known: left out")
    return found


def _straight(pose: np.ndarray, speed: float) -> np.ndarray:
    """Times and poses of one that drives straight on, or stands."""
    time, far = (FAR / abs(speed), math.copysign(FAR, speed)) if speed else (1.0, 0.0)
    x, y, yaw = pose
    end = [time, x + far * math.cos(yaw), y + far * math.sin(yaw), yaw]
    return np.array([[0.0, *pose], end])


def _pose(parent: Any, what: str) -> np.ndarray:
    position = parent.find("Position/WorldPosition")
    if position is None:
        given = [one.tag for one in parent.iterfind("Position/*")]
        raise ValueError(f"{what} must have a WorldPosition, not {', '.join(given)}")
    position.attrib.setdefault("h", "0")
    return np.array([_value(position, key) for key in "xyh"])


def _value(one: Any, key: str) -> float:
    """The number of an attribute; ValueError names it."""
    if one is None:
        return read_number(None, key)
    return read_number(one.get(key), f"{key} of {one.tag}")

"""Scenarios from and to CommonRoad files 2020a, and drives as CommonRoad solutions.

Read: the map as `carpark_mj layouts import` does, the first planning problem with its
start and goal, and dynamic obstacles with trajectories. Positions are middles of
footprints. The car parks by the goal's limits: within the shorter half of its area, in
its orientations, which say which end goes in first, and below its speed.

Written: lanes as lanelets, walls and discs as environment obstacles, kerbs and parked
cars as static ones, movers as dynamic obstacles, the bay as the goal's area, a goal
state for each end that may go in. A file has no other bays, no vehicle, no triggers by
distance, no distance of the rule, no repetitions and no settings.

A solution is of a kinematic car, in the frame of the file, at its time steps. All is
written without `commonroad-io`, whose protobuf excludes ours.
"""

import math
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from carpark_formats.maps.commonroad import number_of, shapes_in, state_pose
from carpark_formats.maps.exporting import axis, rows_of, xml_text
from carpark_formats.maps.features import Report
from carpark_formats.maps.importing import import_map
from carpark_formats.maps.osm_xml import read_xml
from carpark_formats.openscenario import DWELL, actor_of, timeline
from carpark_mj.layouts.types import BayEnd, Layout, WallKind
from carpark_mj.mdp.terminations import find_rules
from carpark_mj.suite.scenario import Scenario
from carpark_mj.vehicle import preset

STEP = 0.1  # s, of files that do not say their time step
NEAR = 1.0  # m between the middles of a goal's area and its bay
MODEL = "KS2:SM1"  # the vehicle and the cost function that a solution must name
_KINDS = {"pedestrian": "person", "bicycle": "cart", "motorcycle": "cart"}
_TYPES = {"person": "pedestrian", "cart": "bicycle", "car": "car"}
_FILE = """<commonRoad commonRoadVersion="2020a" benchmarkID="ZAM_Lot-1_1_T-1"
 date="2000-01-01" author="carpark_mj" affiliation="" source="carpark_mj"
 timeStepSize="{step}"><location><geoNameId>-999</geoNameId><gpsLatitude>999
</gpsLatitude><gpsLongitude>999</gpsLongitude></location><scenarioTags><simulated/>
</scenarioTags>{parts}</commonRoad>"""
_LANELET = """<leftBound>{}</leftBound><rightBound>{}</rightBound>
<laneletType>driveWay</laneletType><user{way}>car</user{way}>"""
_PLACE = """<position><point><x>{:.6f}</x><y>{:.6f}</y></point></position>
<orientation><exact>{:.6f}</exact></orientation><time><exact>{}</exact></time>"""
_STATE = """<ksState><x>{:.6f}</x><y>{:.6f}</y><orientation>{:.6f}</orientation>
<steeringAngle>{:.6f}</steeringAngle><velocity>{:.6f}</velocity><time>{}</time></ksState>"""


def read_commonroad(path: Path) -> tuple[dict[str, Any], Layout, list[str]]:
    """Entries of a scenario without `lot`, see `make_scenario`; its lot, and notes."""
    layout, report = import_map(path)
    report.unknown.pop("dynamicObstacle", None)  # read below
    notes = str(report).splitlines()
    root, problem, dt = _problem(path)
    if others := len(root.findall("planningProblem")) - 1:
        notes.append(f"{others} other planning problems are left out")
    start = problem.find("initialState")
    found: dict[str, Any] = {"start": _placed(start, report).tolist()}
    if (speed := start.find("velocity")) is not None:
        found["speed"] = _middle(speed)
    found |= _goal(problem.findall("goalState"), layout, report, dt)
    found["movers"] = []
    for obstacle in root.iterfind("dynamicObstacle"):
        states = [obstacle.find("initialState"), *obstacle.iterfind("trajectory/state")]
        shapes = shapes_in(obstacle.find("shape"))
        if len(states) < 2 or not shapes:
            notes.append(f"dynamicObstacle {obstacle.get('id')} has no trajectory")
            continue
        kind = _KINDS.get(obstacle.findtext("type", "").strip(), "car")
        left, low, right, high = shapes[0].bounds
        size = [right - left, high - low]
        entries: dict[str, Any] = {"kind": kind, "yields": False}
        entries["size"] = [max(size)] * 2 if kind == "person" else size
        times = [dt * _middle(state.find("time")) for state in states]
        track = np.column_stack([times, [_placed(one, report) for one in states]])
        away = np.abs(track[:, 1:] - track[[[0], [-1]], 1:]).max(axis=2) > DWELL
        # From its last row at the start to the first at the end.
        waits = max(int(away[0].argmax()) - 1, 0)
        ends = np.flatnonzero(away[1]).max(initial=0) + 2
        entries |= {"after": float(track[waits, 0])} if waits else {}
        found["movers"].append(actor_of(track[waits:ends], **entries))
    return found, layout, notes


def _problem(path: Path) -> tuple[Any, Any, float]:
    """The file's outermost element, its first problem, and its time step [s]."""
    root = read_xml(path)
    if (problem := root.find("planningProblem")) is None:
        raise ValueError("there is no planningProblem")
    return root, problem, float(root.get("timeStepSize", STEP))


def _placed(state: Any, report: Report) -> np.ndarray:
    """The pose (3,) of a state in the lot."""
    if (pose := state_pose(state)) is None:
        raise ValueError("a state lacks its position or orientation")
    return _in_lot(*pose, report)


def _in_lot(x: float, y: float, yaw: float, report: Report) -> np.ndarray:
    at = complex(x, y) * np.exp(1j * report.turned) + report.shift
    return np.array([at.real, at.imag, math.remainder(yaw + report.turned, math.tau)])


def _goal(
    states: list[Any], layout: Layout, report: Report, dt: float
) -> dict[str, Any]:
    """The bay, its end, limits and time of goal states, one for each end at most."""
    [state, *_] = states
    if not (shapes := shapes_in(state.find("position"))):
        raise ValueError("the goalState has no area")
    x, y = shapes[0].centroid.coords[0]
    middle = _in_lot(x, y, 0.0, report)[:2]
    away = np.hypot(*(np.asarray(layout.bay_pose)[:, :2] - middle).T)
    away = np.where(layout.bay_mask, away, np.inf)
    bay = int(away.argmin())
    if away[bay] > NEAR:
        raise ValueError("the goal is no bay: its area was left out of the map")
    pose, size = np.asarray(layout.bay_pose)[bay], np.asarray(layout.bay_size)[bay]
    found: dict[str, Any] = {"goal": bay}
    limits = {"distance": float(size.min()) / 2}
    headings = [x for x in (one.find("orientation") for one in states) if x is not None]
    yaws = [_in_lot(0.0, 0.0, _middle(one), report)[2] for one in headings]
    ways = {bool(math.cos(yaw - pose[2]) > 0.0) for yaw in yaws}
    if len(ways) == 1:
        end = "tail_first" if ways == {True} else "nose_first"
        found["goal"] = {"pose": pose.tolist(), "size": size.tolist(), "end": end}
    for heading in headings[:1]:
        low, *_, high = (
            number_of(part, "orientation") for part in [*heading, *heading]
        )
        limits["heading"] = max((high - low) / 2, DWELL)
    if (speed := state.find("velocity")) is not None:
        limits["speed"] = max(number_of(part, "velocity") for part in speed)
    if (time := state.find("time")) is not None:
        found["seconds"] = dt * max(number_of(part, "time") for part in time)
    return found | {"rule": limits}


def _middle(element: Any) -> float:
    """The number in an element, or the middle of its interval."""
    values = [number_of(part, element.tag) for part in element]
    return sum(values) / len(values)


def solution_text(path: Path, time: np.ndarray, drive: np.ndarray) -> str:
    """A drive as a solution of the first planning problem of a file.

    Args:
        path: of the scenario as CommonRoad has it.
        time: (n,) [s], from 0.
        drive: (n, 5) poses in the lot [m, m, rad], steering angles [rad] and speeds.
    """
    root, problem, dt = _problem(path)
    report = import_map(path)[1]
    at = (drive[:, :2] @ [1, 1j] - report.shift) * np.exp(-1j * report.turned)
    yaw = np.unwrap(drive[:, 2]) - report.turned
    columns = at.real, at.imag, yaw, *drive[:, 3:].T
    steps = dt * np.arange(math.ceil(round(time[-1] / dt, 6)) + 1)
    rows = zip(*(np.interp(steps, time, column) for column in columns), strict=True)
    states = "".join(_STATE.format(*row, step) for step, row in enumerate(rows))
    name = quoteattr(f"{MODEL}:{root.get('benchmarkID')}:2020a")
    number = quoteattr(problem.get("id", ""))
    return xml_text(
        f"<CommonRoadSolution benchmark_id={name}><ksTrajectory "
        f"planningProblem={number}>{states}</ksTrajectory></CommonRoadSolution>"
    )


def commonroad_text(scenario: Scenario) -> tuple[str, list[str]]:
    """A scenario as CommonRoad has it, and notes on movers that it has otherwise."""
    layout, car = scenario.layout, preset(scenario.vehicle)
    parts: dict[str, list[str]] = {}  # by kind, in the order of the format
    notes: list[str] = []

    def add(kind: str, inside: str) -> None:
        number = 1 + sum(map(len, parts.values()))
        parts.setdefault(kind, []).append(f'<{kind} id="{number}">{inside}</{kind}>')

    lanes = list(rows_of(layout, "lane", "pose", "size", "one_way"))
    # The format wants a lanelet: without lanes that is the ground.
    ground = np.zeros(3), 2 * np.asarray(layout.extent), False
    for pose, size, one_way in lanes or [ground]:
        borders = [_points(axis(pose, size, y * size[1] / 2)) for y in (1, -1)]
        way = "OneWay" if one_way else "Bidirectional"
        add("lanelet", _LANELET.format(*borders, way=way))
    walls = list(rows_of(layout, "wall", "pose", "size", "kind"))
    own = car.length, car.width
    spots = np.asarray(layout.parked_pose)
    kerbs = [("roadBoundary", *one[:2]) for one in walls if one[2] == WallKind.KERB]
    parked = [("parkedVehicle", spots[bay], own) for bay in scenario.parked]
    for kind, pose, size in kerbs + parked:
        add("staticObstacle", _obstacle(kind, _rectangle(size), _state(pose, 0)))
    steps = np.arange(math.ceil(round(scenario.seconds / STEP, 6)) + 1)
    movers = zip(scenario.movers, scenario.scripts, strict=True)
    for number, (actor, script) in enumerate(movers):
        if script.after is None and (script.near or script.trigger):
            notes.append(f"movers[{number}] sets out at once: triggers are by time")
        time, *columns = timeline(script, layout, scenario.seconds).T
        columns[2] = np.unwrap(columns[2])
        clock = STEP * steps - (script.after or 0.0)
        track = np.transpose([np.interp(clock, time, column) for column in columns])
        first, *others = map(_state, track, steps.tolist())
        way = "".join(f"<state>{state}</state>" for state in others)
        shape = _rectangle(script.size)
        if actor.kind == "person":
            shape = f"<circle><radius>{max(script.size) / 2:.6f}</radius></circle>"
        body = _obstacle(_TYPES[actor.kind], shape, first)
        add("dynamicObstacle", f"{body}<trajectory>{way}</trajectory>")
    for pose, size, kind in walls:
        if kind != WallKind.KERB:
            add("environmentObstacle", _obstacle("building", _rectangle(size, pose)))
    for centre, radius in rows_of(layout, "disc", "centre", "radius"):
        at = f"<radius>{radius:.6f}</radius><center>{_xy(centre)}</center>"
        add("environmentObstacle", _obstacle("pillar", f"<circle>{at}</circle>"))
    other = _exact(velocity=scenario.speed, yawRate=0.0, slipAngle=0.0)
    goals = "".join(_goal_states(scenario, int(steps[-1])))
    start = f"<initialState>{_state(scenario.start, 0)}{other}</initialState>"
    add("planningProblem", start + goals)
    inside = "".join(row for rows in parts.values() for row in rows)
    return xml_text(_FILE.format(step=STEP, parts=inside)), notes


def _goal_states(scenario: Scenario, steps: int) -> list[str]:
    """The bay with limits of the rule, once for each end that may go in."""
    layout, bay = scenario.layout, scenario.goal_bay
    rule, *_ = find_rules(scenario.rule_name)
    pose, size = np.asarray(layout.bay_pose)[bay], np.asarray(layout.bay_size)[bay]
    ends = BayEnd.EITHER if layout.bay_end is None else BayEnd(layout.bay_end[bay])
    turns = {BayEnd.TAIL_FIRST: [0.0], BayEnd.NOSE_FIRST: [math.pi]}
    limits = f"<time>{_interval(0, steps)}</time>"
    limits += f"<position>{_rectangle(size, pose)}</position>"
    if rule.speed is not None:
        limits += f"<velocity>{_interval(-rule.speed, rule.speed)}</velocity>"
    found = []
    for turn in turns.get(ends, [0.0, math.pi] if rule.heading else []):
        off, yaw = rule.heading or math.pi / 2, math.remainder(pose[2] + turn, math.tau)
        heading = f"<orientation>{_interval(yaw - off, yaw + off)}</orientation>"
        found.append(f"<goalState>{limits}{heading}</goalState>")
    return found or [f"<goalState>{limits}</goalState>"]


def _obstacle(kind: str, shape: str, state: str = "") -> str:
    state = f"<initialState>{state}</initialState>" * bool(state)
    return f"<type>{kind}</type><shape>{shape}</shape>{state}"


def _state(pose: Any, step: int) -> str:
    return _PLACE.format(*pose[:2], math.remainder(pose[2], math.tau), step)


def _rectangle(size: Any, pose: Any = None) -> str:
    inside = f"<length>{size[0]:.6f}</length><width>{size[1]:.6f}</width>"
    if pose is not None:
        inside += (
            f"<orientation>{pose[2]:.6f}</orientation><center>{_xy(pose)}</center>"
        )
    return f"<rectangle>{inside}</rectangle>"


def _points(line: Any) -> str:
    return "".join(f"<point>{_xy(at)}</point>" for at in line)


def _xy(at: Any) -> str:
    return f"<x>{at[0]:.6f}</x><y>{at[1]:.6f}</y>"


def _exact(**values: float) -> str:
    rows = values.items()
    return "".join(f"<{k}><exact>{v:.6f}</exact></{k}>" for k, v in rows)


def _interval(low: float, high: float) -> str:
    low, high = round(low, 6), round(high, 6)
    return f"<intervalStart>{low}</intervalStart><intervalEnd>{high}</intervalEnd>"

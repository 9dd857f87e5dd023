"""Scenarios from CommonRoad files 2020a, and drives as CommonRoad solutions.

Read: the map as `carpark_mj layouts import` does, the first planning problem with its
start and goal, and dynamic obstacles with trajectories. Positions are middles of
footprints. The car parks by the goal's limits: within the shorter half of its area, in
its orientations, which say which end goes in first, and below its speed.

A solution is of a kinematic car, in the frame of the file, at its time steps. It is
written without `commonroad-io`, whose protobuf excludes ours.
"""

import math
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from carpark_mj.layouts.types import Layout
from carpark_mj.maps.commonroad import number_of, shapes_in, state_pose
from carpark_mj.maps.exporting import xml_text
from carpark_mj.maps.features import Report
from carpark_mj.maps.importing import import_map
from carpark_mj.maps.osm_xml import read_xml
from carpark_mj.suite.openscenario import DWELL, actor_of

STEP = 0.1  # s, of files that do not say their time step
NEAR = 1.0  # m between the middles of a goal's area and its bay
MODEL = "KS2:SM1"  # the vehicle and the cost function that a solution must name
_KINDS = {"pedestrian": "person", "bicycle": "cart", "motorcycle": "cart"}
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
        moves = np.abs(track[:, 1:] - track[0, 1:]).max(axis=1) > DWELL
        waits = max(int(moves.argmax()) - 1, 0)
        entries |= {"after": float(track[waits, 0])} if waits else {}
        found["movers"].append(actor_of(track[waits:], **entries))
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

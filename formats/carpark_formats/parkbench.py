"""ParkBench's cases: rear-in parking that a car recorded, from JSON files.

51 cases of Tao et al. 2026 (arXiv 2601.22545). The data are CC BY-NC 4.0: users fetch
them (docs/hard_cases.md#parkbench), the package has none. Of `Frames."0"` of a file:

- `PlanningRequest.m_startPosture.m_pose` and `m_targetArea.m_targetPosture.m_pose` (or
  `m_targetAreas.m_targetPosture[0].m_pose`): x, y [m] and heading [rad] of the rear
  axle; `PlanningRequest.m_origin` is added and `m_nfmOrigin` subtracted, if given;
- `NfmAggregatedPolygonObjects[].nfmPolygonObjectNodes[]`: nodes `m_x`, `m_y` [m] of
  polylines, the outlines that the car perceived.

Every piece of a polyline within `REACH` of the goal becomes a wall 2 cm thick. As in
ParkBench's own script, pieces that overlap the parked car are left out. The goal is the
only bay, which the car enters tail first.

To keep results honest, only half of the cases is for work, the first, third, fifth
file in the order of names. The others are held out: look at them once, at the end.
"""

import dataclasses
import functools
import hashlib
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.layouts.files import FARTHEST
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import BayEnd, Layout
from carpark_mj.reading import naming_file, parse_object, read_bytes, read_text
from carpark_mj.suite import hope
from carpark_mj.suite.levels import LEVELS, CaseLevel, Cases
from carpark_mj.suite.tpcap import EDGE, Boxes, boxes_along, case_layout, stack_layouts

NAME, HELD_OUT = "parkbench", "held_out"
KEY = "Frames"  # at the top of a file
# As the paper draws it: 1.05 m behind to 3.9 m ahead of the rear axle.
PARKBENCH_CAR = DesignCar(length=4.95, width=2.0, rear_overhang=1.05)
MARGIN = 0.3  # m of the bay on every side of the car, less where walls are near
REACH = 20.0  # m from the goal within which pieces are kept
KIND = "recorded"


def read_parkbench(path: Path) -> Layout:
    """Reads a case; ValueError if there is none."""
    with naming_file(path):
        return parkbench_layout(parse_object(read_text(path), "the case"))


def parkbench_layout(data: Mapping[str, Any]) -> Layout:
    """The lot of the object of a ParkBench file; ValueError if it is none."""
    try:
        frame = data[KEY]["0"]
        request = frame["PlanningRequest"]
        origin, frame_origin = (
            np.array(part.get(name, (0.0, 0.0))[:2], float).reshape(2)
            for part, name in ((request, "m_origin"), (frame, "m_nfmOrigin"))
        )
        if "m_targetArea" in request:
            target = request["m_targetArea"]["m_targetPosture"]
        else:
            target = request["m_targetAreas"]["m_targetPosture"][0]
        poses = [request["m_startPosture"]["m_pose"], target["m_pose"]]
        poses = np.array(poses, float).reshape(2, 3)
        lines = [
            [(node["m_x"], node["m_y"]) for node in part["nfmPolygonObjectNodes"]]
            for part in frame["NfmAggregatedPolygonObjects"]
        ]
        pieces = [piece for line in lines for piece in itertools.pairwise(line)]
        points = np.array(pieces, float).reshape(-1, 2, 2)
    except Exception as error:  # of many kinds, about the form of the data
        raise ValueError(f"no case of ParkBench: {error!r}") from None
    poses[:, :2] += origin - frame_origin
    if not (np.isfinite(poses).all() and np.isfinite(points).all()):
        raise ValueError("a coordinate is not a finite number")
    start, goal = poses
    if (away := math.dist(start[:2], goal[:2])) > FARTHEST:
        raise ValueError(f"the start must be within {FARTHEST:g} m, not {away:g} m")
    pieces, end = list(points[_distance(points, goal[:2]) < REACH]), BayEnd.TAIL_FIRST
    return case_layout(PARKBENCH_CAR, start, goal, pieces, _wall, MARGIN, end, True)


def _distance(piece: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(n,) distances of a point (2,) from pieces (n, 2, 2) [m]."""
    first, along = piece[:, 0], piece[:, 1] - piece[:, 0]
    share = np.sum((point - first) * along, axis=1)
    share = np.clip(share / np.maximum(np.sum(along**2, axis=1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(first + share[:, None] * along - point, axis=1)


def _wall(piece: np.ndarray) -> Boxes:
    """The wall along a piece (2, 2), on both sides of it."""
    pose, size = boxes_along(piece[:1], piece[1:], EDGE)
    return pose, np.maximum(size, EDGE)


@functools.cache
def parkbench_level(path: str) -> CaseLevel:
    """The level of a folder of cases, or with `:held_out` of its other half."""
    if not path:
        raise ValueError(f"level {NAME} needs a folder, {NAME}:FOLDER")
    folder = Path(path.removesuffix(f":{HELD_OUT}"))
    files = sorted(folder.glob("*.json"))
    numbers = range(int(path.endswith(f":{HELD_OUT}")), len(files), 2)
    if not numbers:
        raise ValueError(f"{folder} has only {len(files)} ParkBench files (*.json)")
    data = b"".join(read_bytes(files[number]) for number in numbers)

    def pick(which: slice) -> Cases:
        number = np.array(numbers[which])
        cases = [jax.device_get(read_parkbench(files[k])) for k in number]
        kind = np.full(len(number), KIND)
        return Cases(f"{NAME}:{path}", number, kind, stack_layouts(cases))

    sha256 = hashlib.sha256(data).hexdigest()
    source = "ParkBench's cases (CC BY-NC 4.0)"
    return CaseLevel(numbers, sha256, pick, parkbench_env, source)


def parkbench_env(env: EnvConfig) -> EnvConfig:
    """An environment of the suite whose bays have room for ParkBench's car."""
    more = 2 * (MARGIN - hope.MARGIN)
    size = {name: getattr(PARKBENCH_CAR, name) + more for name in ("length", "width")}
    lots = hope.HopeConfig(car=dataclasses.replace(PARKBENCH_CAR, **size))
    return dataclasses.replace(env, layout=lots)


LEVELS.register(NAME, parkbench_level)

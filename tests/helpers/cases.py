"""Episodes of the suite and drives, as it writes them."""

import numpy as np

from carpark_mj.suite.levels import find_level
from carpark_mj.suite.results import Drives
from carpark_mj.types import ENDINGS

AMONG = dict.fromkeys(("hit_person", "hit_mover", "near_miss", "contact_speed"), 0.0)
AMONG["least_gap"] = 1.0  # m, of levels with movers


def episode(case, level="normal", end="parked", **more):
    """A row of `cases.csv`."""
    which = {"policy": "x", "rule": "strict", "made_with": "cpu", "seed": 0}
    which |= {"held_out": find_level(level).fingerprint, "level": level, "case": case}
    which |= {"kind": "parallel", **dict.fromkeys(ENDINGS, 0.0), end: 1.0}
    drive = {"hit_agent": 0.0, "length": 4.0 + case, "path": 9.0, "gear_changes": 2.0}
    drive |= {"time_to_park": 30.0, "final_distance": 0.1, "final_heading": 0.1}
    return {**which, **drive, "ms / decision": 2.0, **more}


def drives(length, agents=1):
    """The path of a car that stands."""
    shape = (1, length, agents)
    pose = np.broadcast_to(np.array([1.0, 2.0, 3.0], np.float32), (*shape, 2, 3))
    return Drives(pose, np.ones(shape, np.float32), np.ones(shape, np.float32))

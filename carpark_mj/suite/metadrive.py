"""MetaDrive's multi-agent parking lot: cars drive in and park while others drive out.

A road with four spaces on either side ends in a T-junction, so that the lot has three
entrances, which are exits too. Numbers are those of MetaDrive 0.2.5 (Li et al. 2021,
arXiv 2109.12674; repository metadriverse/metadrive, `marl_parking_lot.py`,
`parking_lot.py`, `t_intersection.py`, `spawn_manager.py` and the tables of parameters),
with which CoPO's table was made (Peng et al. 2021, arXiv 2110.13827).

An exit is a bay of the kind `EXIT` over the lane that leaves: the last 10 m of it.
Deviations: kerbs close the ends of the roads, rounded corners are three chords. The T's
arms lie to both sides of the road [inferred from the numbers of its entrances].
"""

import dataclasses
import math
from typing import Annotated

import jax
import numpy as np

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    GoalConfig,
    LayoutConfig,
    SpawnConfig,
    register_layout,
)
from carpark_mj.config.checks import Bounds
from carpark_mj.layouts.build import assemble, bays, lanes, spawns, two_lanes, walls
from carpark_mj.layouts.types import BayKind, Layout, WallKind
from carpark_mj.registry import ENVIRONMENTS
from carpark_mj.suite.tpcap import boxes_along

LANE = 3.5  # m, width of a lane and of a space
SPACE = 8.0  # m, length of a space
BEND = 4.0  # m, radius of the way from a lane's middle into a space
ENTRANCE = 20.0  # m, road before the lot; cars start and leave on the half next to it
SOCKET = 4.0  # m, road between the lot and the junction
JUNCTION_BEND = 10.0  # m, radius of a right turn from the middle of a lane
ARM = 10.0  # m, road beyond the junction
START = 4.0  # m from the beginning of the road, or the end of the space, to a start
STRAY = (2.0, 0.5)  # m, along and across: slot of 8 m x 3 m less the largest car
KERB = 0.3  # m, thickness
CHORDS = 3  # of a rounded corner


@dataclasses.dataclass(frozen=True)
class MetaDriveConfig(LayoutConfig):
    """MetaDrive's parking lot.

    Attributes:
        spaces: on both sides together, an even number.
    """

    spaces: Annotated[int, Bounds(ge=4, le=1000)] = 8
    family: str = "metadrive"
    is_random = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.spaces % 2:
            raise ValueError(f"spaces must be an even number, not {self.spaces}")

    @property
    def min_bays(self) -> int:
        """The spaces and three exits."""
        return self.spaces + 3

    def generate(self, key: jax.Array) -> Layout:
        """Builds the lot; the road comes from -x, and the junction lies at +x."""
        del key
        half = LANE / 2
        space_x = ENTRANCE + BEND + LANE * np.arange(self.spaces // 2)
        junction = space_x[-1] + BEND + SOCKET
        near, far = (junction + JUNCTION_BEND + offset for offset in (-half, 3 * half))
        arm_y = half + JUNCTION_BEND  # where the arms begin
        end_y = arm_y + ARM
        depth = half + BEND  # where spaces begin
        middle = np.array([far / 2, 0.0, 0.0])
        up, down = math.pi / 2, -math.pi / 2
        space_y = depth + SPACE / 2
        space = [(x, s * space_y, -s * up) for s in (-1, 1) for x in space_x]
        # Headings point into the lot, as those of bays do into the aisle.
        exits = [
            (ENTRANCE - ARM / 2, half, 0.0),
            (near + half, -arm_y - ARM / 2, up),
            (far - half, arm_y + ARM / 2, down),
        ]
        starts = [
            (ENTRANCE - ARM + START, -half, 0.0),
            (far - half, START - end_y, up),
            (near + half, end_y - START, down),
        ]
        starts += [(x, y - math.copysign(SPACE / 2 - START, y), h) for x, y, h in space]
        roads = two_lanes(
            np.array([(near / 2, 0.0, 0.0), ((near + far) / 2, 0.0, up)]) - middle,
            np.array([(near, 2 * LANE), (2 * end_y, 2 * LANE)]),
        )
        kerbs = _outline(space_x, junction, (near, far)) - middle[:2]
        ends = np.roll(kerbs, -1, axis=0)
        return assemble(
            (far / 2 + KERB, end_y + KERB),
            bays(np.array(space) - middle, (SPACE, LANE)),
            bays(np.array(exits) - middle, (ARM, LANE), BayKind.EXIT),
            walls(*boxes_along(kerbs, ends, KERB, 1.0), WallKind.KERB),
            lanes(*roads, one_way=True),
            spawns(np.array(starts) - middle, STRAY, 0.0),
        )


def _outline(
    space_x: np.ndarray, junction: float, arm: tuple[float, float]
) -> np.ndarray:
    """Corners (n, 2) of the ground that cars may drive on, clockwise."""
    half, (near, far) = LANE / 2, arm
    depth, end = half + BEND + SPACE, half + JUNCTION_BEND + ARM
    left, right = space_x[0] - half, space_x[-1] + half
    upper = [
        np.array([(0.0, LANE)]),
        _corner((left - BEND + half, half + BEND), BEND - half, -90.0, 0.0),
        np.array([(left, depth), (right, depth)]),
        _corner((right + BEND - half, half + BEND), BEND - half, 180.0, 270.0),
        _corner((junction, half + JUNCTION_BEND), JUNCTION_BEND - half, -90.0, 0.0),
        np.array([(near, end), (far, end)]),
    ]
    above = np.concatenate(upper)
    return np.concatenate([above, above[::-1] * [1.0, -1.0]])


def _corner(
    centre: tuple[float, float], radius: float, begin: float, end: float
) -> np.ndarray:
    """Points of an arc from one angle [deg] to another about a solid corner."""
    angle = np.radians(np.linspace(begin, end, CHORDS + 1))
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], 1)


register_layout("metadrive", MetaDriveConfig())


# MetaDrive's multi-agent parking lot: 10 agents, 100 s; docs/metadrive.md says what
# differs. Starts keep a car's length apart, or as far as they can.
METADRIVE = EnvConfig(
    layout="metadrive",
    num_agents=10,
    num_parked_cars=0,
    goals=GoalConfig(drive_out=True),
    spawn=SpawnConfig(close_ratio=0.0, min_distance=4.6, num_candidates=64),
    episode=EpisodeConfig(parked_rule="metadrive", max_steps=500),
)

ENVIRONMENTS.register("metadrive", METADRIVE)

"""Dimensions of what stands in a lot and of the paint on its ground [m].

Pictures, colliding bodies and cameras share them.
"""

from carpark_mj.geometry.obstacles import Boxes, Discs, Group
from carpark_mj.layouts.types import DiscKind, WallKind

WALL_HEIGHT = 0.9  # low enough for the cameras of videos
KERB_HEIGHT = 0.14
WALL_HEIGHTS = {
    WallKind.WALL: WALL_HEIGHT,
    WallKind.KERB: KERB_HEIGHT,
    WallKind.ISLAND: KERB_HEIGHT,
    WallKind.GATE: WALL_HEIGHT,
}
DISC_HEIGHTS = {DiscKind.PILLAR: 2.4, DiscKind.BOLLARD: 0.9}
MOVER_HEIGHTS: dict[type[Group], float] = {Boxes: 1.1, Discs: 1.7}  # cart, person
GROUND_CLEARANCE = 0.16  # under a car

LINE_WIDTH = 0.10  # painted bay lines
LINE_HEIGHT = 0.004  # above the asphalt so that it is not hidden
ARROW_LENGTH, ARROW_WIDTH = 2.0, 0.8
ARROW_HEAD = 0.4  # share of its length
ARROW_SHAFT = 0.3  # width of its shaft over that of its head
ARROW_HEIGHT = LINE_HEIGHT / 2
ARROW_SPACING = 9.0  # along a lane
VERGE_GAP, VERGE_HEIGHT = 1.0, 0.01  # asphalt left around the walls, and grass

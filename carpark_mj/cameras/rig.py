"""Cameras on a car: where they sit, what they look through, and named sets of them."""

import dataclasses
import enum
import functools
import math

import numpy as np

from carpark_mj.cameras.lens import Lens
from carpark_mj.config.checks import (
    CheckedConfig,
    require_finite,
    require_positive,
    require_whole,
)
from carpark_mj.extensions import Registry


class Seen(enum.IntEnum):
    """What a pixel shows."""

    FLOOR = 0
    LINE = 1  # and arrows
    OWN_BAY = 2  # the ground of the goal
    BAY = 3
    WALL = 4  # pillars, bollards and gates too
    CAR = 5  # movers that are no people too
    PERSON = 6
    KERB = 7  # islands too
    SKY = 8
    OWN_CAR = 9


MOST_PIXELS = 1920 * 1080  # of a picture, full HD; the rays of all are kept

# Cars as cameras see them: blocks from, to (half lengths ahead of the centre), half as
# wide (half widths), low and high (heights). The body has the footprint; the cabin is
# fitted to the meshes of the shipped cars by eye.
CarBlock = tuple[float, float, float, float, float]
BODY: CarBlock = (-1.0, 1.0, 1.0, 0.0, 0.60)
CABIN: CarBlock = (-0.90, 0.40, 0.78, 0.60, 1.0)


@dataclasses.dataclass(frozen=True)
class Camera(CheckedConfig):
    """A camera on a car. In the cabin it looks out of it, as if it were of glass.

    Attributes:
        position: half lengths ahead of the footprint's centre, half widths to the left
            of it, heights of the car above the ground: (1, 0, 0.5) is on the nose.
        yaw: of its axis, to the left [rad].
        pitch: of its axis, down [rad].
        roll: about its axis, the right side down [rad].
        lens: what it looks through.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    lens: Lens = dataclasses.field(default_factory=Lens)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite(self, "yaw", "pitch", "roll")
        x, y, z = self.position
        if not (all(map(math.isfinite, self.position)) and z > 0.0):
            raise ValueError(
                f"position of a camera must be finite and above the ground, not "
                f"{self.position}"
            )
        if max(abs(x), abs(y)) <= 1.0 and z <= BODY[-1]:
            raise ValueError(
                f"position {self.position} lies inside the body, where a camera sees "
                f"nothing: choose one beyond 1 half length or half width, or above "
                f"{BODY[-1]} of the height"
            )

    @functools.cached_property
    def axes(self) -> np.ndarray:
        """(3, 3) its axis, left and up as columns in the body's frame."""
        (sy, cy), (sp, cp), (sr, cr) = (
            (math.sin(x), math.cos(x)) for x in (self.yaw, self.pitch, self.roll)
        )
        turn = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
        nod = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
        lean = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
        return turn @ nod @ lean


@dataclasses.dataclass(frozen=True)
class Rig(CheckedConfig):
    """The cameras of a car, all of one resolution.

    Attributes:
        cameras: at least one.
        width: of a picture [pixels].
        height: of a picture [pixels].
        reach: depths are at most this [m], that of the sky is.
        shaded: tell how bright the sun makes what is seen.
    """

    cameras: tuple[Camera, ...]
    width: int = 64
    height: int = 48
    reach: float = 50.0
    shaded: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require_whole(self, 1, "width", "height")
        require_positive(self, "reach")
        if self.width * self.height > MOST_PIXELS:
            raise ValueError(
                f"width x height must be at most {MOST_PIXELS} pixels, not "
                f"{self.width} x {self.height}"
            )
        if not self.cameras:
            raise ValueError("cameras must be at least one, not ()")
        _ = self.directions  # refuses lenses that have no ray for some pixels

    @functools.cached_property
    def directions(self) -> np.ndarray:
        """(cameras, height, width, 3) unit vectors of the rays in the body's frame."""
        return np.stack(
            [
                camera.lens.directions(self.width, self.height) @ camera.axes.T
                for camera in self.cameras
            ]
        ).astype(np.float32)


_FISHEYE = Lens("fisheye", math.radians(190.0))


def _turned(yaw: float, pitch: float) -> dict[str, float]:
    return {"yaw": math.radians(yaw), "pitch": math.radians(pitch)}


FRONT = Camera((1.01, 0.0, 0.42), **_turned(0.0, 30.0), lens=_FISHEYE)
REAR = Camera((-1.01, 0.0, 0.60), **_turned(180.0, 35.0), lens=_FISHEYE)
LEFT = Camera((0.30, 1.12, 0.68), **_turned(90.0, 45.0), lens=_FISHEYE)
RIGHT = Camera((0.30, -1.12, 0.68), **_turned(-90.0, 45.0), lens=_FISHEYE)
WINDSCREEN = Camera(
    (0.20, 0.0, 0.88), **_turned(0.0, 8.0), lens=Lens(fov=math.radians(100.0))
)

RIGS: Registry[Rig] = Registry("camera rig")
RIGS.register("surround", Rig((FRONT, REAR, LEFT, RIGHT)))
RIGS.register("rear", Rig((REAR,)))
RIGS.register("windscreen", Rig((WINDSCREEN,)))

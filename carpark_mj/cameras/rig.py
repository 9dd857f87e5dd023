"""Cameras on a car: lenses, where they sit, named sets of them, and their faults."""

import dataclasses
import enum
import functools
import math
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    Finite,
    Natural,
    NonNegative,
    Positive,
    Range,
    require_number,
)
from carpark_mj.geometry.se2 import norm

Projection = Literal["pinhole", "fisheye"]


@dataclasses.dataclass(frozen=True)
class Lens(CheckedConfig):
    """A lens whose picture is round about its axis.

    A ray at an angle to the axis falls at a radius of g (1 + k1 g² + k2 g⁴ + ...); g is
    the angle of an equidistant fisheye (Kannala and Brandt 2006), the tangent of a
    pinhole camera (Brown 1971).

    Attributes:
        projection: which of the two.
        fov: angle that the width of the picture spans [rad].
        distortion: k1, k2...; none by default.
    """

    projection: Projection = "pinhole"
    fov: Annotated[float, Bounds(gt=0.0, le=2 * math.pi, unit="rad")] = math.pi / 2
    distortion: Annotated[tuple[float, ...], Bounds()] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.projection == "pinhole":
            require_number("fov", self.fov, Bounds(lt=math.pi, unit="rad, a pinhole's"))

    def radius(self, angle: np.ndarray) -> np.ndarray:
        """Radii in the picture of rays at angles to the axis [rad], no unit."""
        g = np.tan(angle) if self.projection == "pinhole" else np.asarray(angle)
        terms = (k * g ** (2 * n) for n, k in enumerate(self.distortion, start=1))
        return g * (1.0 + sum(terms, np.zeros_like(g)))

    def directions(self, width: int, height: int) -> np.ndarray:
        """Unit vectors (height, width, 3) of the pixels' middles, rows from the top.

        In the frame of the camera: x along the axis, y left, z up.
        """
        scale = float(self.radius(np.array(self.fov / 2))) / (width / 2)
        left = width / 2 - 0.5 - np.arange(width)
        up = height / 2 - 0.5 - np.arange(height)
        left, up = (scale * x for x in np.meshgrid(left, up))
        radius = np.hypot(left, up)
        angle = self._angle(radius, width, height)
        aside = np.sin(angle) / np.where(radius > 0.0, radius, 1.0)
        return np.stack([np.cos(angle), aside * left, aside * up], axis=-1)

    def _angle(self, radius: np.ndarray, width: int, height: int) -> np.ndarray:
        """Angles [rad] to the axis of rays that fall at radii; inverts `radius`."""
        most = math.pi / 2 - 1e-6 if self.projection == "pinhole" else math.pi
        angles = np.linspace(0.0, most, 4096)
        radii = self.radius(angles)
        rising = np.append(np.diff(radii) > 0.0, True)
        known = len(radii) if rising.all() else int(np.argmin(rising)) + 1
        if radius.max() > radii[known - 1]:
            degrees = 2.0 * math.degrees(angles[known - 1])
            raise ValueError(
                f"fov {math.degrees(self.fov):g} deg over {width} x {height} pixels "
                f"reaches beyond {degrees:.0f} degrees, where the lens shows nothing"
            )
        low, high = np.zeros_like(radius), np.full_like(radius, angles[known - 1])
        for _ in range(60):
            middle = (low + high) / 2
            below = self.radius(middle) < radius
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        return (low + high) / 2


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
        lens: its projection.
    """

    position: Annotated[tuple[float, float, float], Bounds()]
    yaw: Finite = 0.0
    pitch: Finite = 0.0
    roll: Finite = 0.0
    lens: Lens = dataclasses.field(default_factory=Lens)

    def __post_init__(self) -> None:
        super().__post_init__()
        x, y, z = self.position
        if z <= 0.0:
            raise ValueError(f"a camera must be above the ground, not at {x, y, z}")
        if max(abs(x), abs(y)) <= 1.0 and z <= BODY[-1]:
            raise ValueError(
                f"position must be beyond 1 half length or half width, or above "
                f"{BODY[-1]} of the height, not inside the body at {self.position}"
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
        shaded: whether pictures have the brightness of faces.
    """

    cameras: tuple[Camera, ...]
    width: Count = 64
    height: Count = 48
    reach: Positive = 50.0
    shaded: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        most = Bounds(le=MOST_PIXELS, unit="pixels")
        require_number("width x height", self.width * self.height, most)
        if not self.cameras:
            raise ValueError("cameras must be at least one, not ()")
        _ = self.directions  # refuses lenses that have no ray for some pixels

    @functools.cached_property
    def directions(self) -> np.ndarray:
        """(cameras, height, width, 3) unit vectors of the rays in the body's frame."""
        size = self.width, self.height
        rays = [each.lens.directions(*size) @ each.axes.T for each in self.cameras]
        return np.stack(rays).astype(np.float32)


def _fisheye(x: float, y: float, z: float, yaw: float, pitch: float) -> Camera:
    """With a view of 190 degrees; angles in degrees."""
    lens = Lens("fisheye", math.radians(190.0))
    return Camera((x, y, z), math.radians(yaw), math.radians(pitch), lens=lens)


FRONT = _fisheye(1.01, 0.0, 0.42, yaw=0.0, pitch=30.0)
REAR = _fisheye(-1.01, 0.0, 0.60, yaw=180.0, pitch=35.0)
LEFT = _fisheye(0.30, 1.12, 0.68, yaw=90.0, pitch=45.0)
RIGHT = _fisheye(0.30, -1.12, 0.68, yaw=-90.0, pitch=45.0)
_WIDE = Lens(fov=math.radians(100.0))
WINDSCREEN = Camera((0.20, 0.0, 0.88), pitch=math.radians(8.0), lens=_WIDE)

RigName = Literal["surround", "rear", "windscreen"]
RIGS: dict[str, Rig] = {
    "surround": Rig((FRONT, REAR, LEFT, RIGHT)),
    "rear": Rig((REAR,)),
    "windscreen": Rig((WINDSCREEN,)),
}


@dataclasses.dataclass(frozen=True)
class FaultConfig(CheckedConfig):
    """How wrong cameras can be; not at all by default.

    Attributes:
        turn: standard deviation of their mounting about each axis [rad].
        shift: standard deviation of their mounting along each axis [m].
        spots: number of spots of dirt on each lens.
        spot_size: largest radius of a spot over the height of the picture.
        exposure: range of the factor on brightness.
        depth_noise: standard deviation of the noise on depth over the depth.
        colour_noise: standard deviation of the noise on colours, which lie in [0, 1].
    """

    turn: NonNegative = 0.0
    shift: NonNegative = 0.0
    spots: Natural = 0
    spot_size: NonNegative = 0.1
    exposure: Annotated[Range, Bounds(ge=0.0)] = (1.0, 1.0)
    depth_noise: NonNegative = 0.0
    colour_noise: NonNegative = 0.0


@struct.dataclass
class Faults:
    """Faults of the cameras of cars (num_agents, cameras, ...), for an episode."""

    turn: jax.Array  # (..., 3, 3) rotations of the rays in the body's frame
    shift: jax.Array  # (..., 3) of the cameras in the body's frame [m]
    spots: jax.Array  # (..., n, 3) row, column and radius of dirt [picture heights]
    exposure: jax.Array  # (...) factor on brightness


def draw_faults(
    config: FaultConfig, rig: Rig, num_agents: int, key: jax.Array
) -> Faults:
    """Faults of an episode; `key` is consumed."""
    lead = (num_agents, len(rig.cameras))
    turn_key, shift_key, spot_key, exposure_key = jax.random.split(key, 4)
    angle = config.turn * jax.random.normal(turn_key, (*lead, 3))
    most = jnp.array([1.0, rig.width / rig.height, config.spot_size])
    low, high = config.exposure
    return Faults(
        turn=_rotation(angle),
        shift=config.shift * jax.random.normal(shift_key, (*lead, 3)),
        spots=most * jax.random.uniform(spot_key, (*lead, config.spots, 3)),
        exposure=jax.random.uniform(exposure_key, lead, minval=low, maxval=high),
    )


def noisy_depth(
    config: FaultConfig, depth: jax.Array, reach: float, key: jax.Array
) -> jax.Array:
    """Depths (...) [m] with noise, at most the reach; `key` is consumed."""
    noise = config.depth_noise * jax.random.normal(key, depth.shape)
    return jnp.where(depth < reach, jnp.clip(depth * (1.0 + noise), 0.0, reach), depth)


def _rotation(angle: jax.Array) -> jax.Array:
    """Rotations (..., 3, 3) by vectors (..., 3) [rad]."""
    cross = jnp.swapaxes(jnp.cross(angle[..., None, :], jnp.eye(3)), -1, -2)
    size = jnp.linalg.norm(angle, axis=-1)[..., None, None]
    first, second = jnp.sinc(size / jnp.pi), jnp.sinc(size / (2 * jnp.pi)) ** 2 / 2
    return jnp.eye(3) + first * cross + second * (cross @ cross)  # Rodrigues


def is_dirty(rig: Rig, spots: jax.Array) -> jax.Array:
    """Pixels (..., height, width) under any of the spots (..., n, 3)."""
    row = (jnp.arange(rig.height) + 0.5)[:, None] / rig.height
    column = (jnp.arange(rig.width) + 0.5) / rig.height
    place = spots[..., None, None, :]
    off = jnp.broadcast_arrays(row - place[..., 0], column - place[..., 1])
    off = jnp.stack(off, axis=-1)
    return jnp.any(norm(off) < place[..., 2], axis=-3)


def car_cameras(camera: str, size: tuple[int, int]) -> Rig | None:
    """The cameras that a flag names, with the resolution of their part of a frame.

    The flag is a rig by name, or one of its cameras, as `surround:0`; `size` is the
    width and height of a frame [pixels]. None if there is no rig of that name.
    """
    name, colon, index = camera.partition(":")
    rig = RIGS.get(name)
    if rig is None:
        return None
    cameras = rig.cameras
    if colon:
        if not (index.isdecimal() and int(index) < len(cameras)):
            raise ValueError(
                f"unknown camera {camera!r}; choose {name} or {name}:K with K from 0 "
                f"to {len(cameras) - 1}"
            )
        cameras = (cameras[int(index)],)
    rows, columns = picture_grid(len(cameras))
    width, height = size[0] // columns, size[1] // rows
    return Rig(cameras, width, height, rig.reach, shaded=True)


def picture_grid(count: int) -> tuple[int, int]:
    """Rows and columns for a number of pictures."""
    columns = math.ceil(math.sqrt(count))
    return -(-count // columns), columns

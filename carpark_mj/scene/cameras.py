"""Cameras of a scene: two that show the whole lot, two on every agent's car."""

import itertools
import math

import mujoco
import numpy as np

from carpark_mj.scene.car_mesh import driver_eye
from carpark_mj.vehicle.parameters import VehicleParameters

Point = tuple[float, float, float]

LEAST_ASPECT = 4 / 3  # width over height of the narrowest frame that shows the lot
_FOVY = {"topdown": 30.0, "overview": 38.0}  # deg
_ELEVATION = {"topdown": math.pi / 2, "overview": math.radians(45)}  # rad
# What must be in the frame: walls stand on the edge of the lot.
_MARGIN, _TALL = 0.8, 1.0  # m
_LONG = 1.05  # over its width; a longer lot is seen from its side


def fit_eye(
    points: np.ndarray, axes: np.ndarray, fovy: float, aspect: float
) -> np.ndarray:
    """The nearest eye (3,) [m] from which a camera sees all points (n, 3) [m].

    `axes` (3, 3) are columns right, up and back of the camera, `fovy` its vertical
    field of view [deg], `aspect` width over height of the frame.
    """
    tangent = math.tan(math.radians(fovy) / 2) * np.array([aspect, 1.0])
    seen = points @ axes
    ahead = seen[:, 2:] * tangent
    high = (seen[:, :2] + ahead).max(axis=0)
    low = (-seen[:, :2] + ahead).max(axis=0)
    back = ((high + low) / (2 * tangent)).max()
    return axes @ np.append((high - low) / 2, back)


def view_yaw(extent: np.ndarray, aspect: float = LEAST_ASPECT) -> float:
    """Direction [rad] that is to the right in the frames of `LOT_CAMERAS`.

    A lot of half widths `extent` (2,) [m] is seen from the south, or from the west if
    its longer side then lies along the frame's; `aspect` is the frame's width / height.
    """
    x, y = extent if aspect >= 1.0 else extent[::-1]
    return -math.pi / 2 if y > _LONG * x else 0.0


def frame_lot(
    camera: str, extent: np.ndarray, aspect: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and quaternion (4,) at which a camera shows the whole lot.

    The camera is `topdown` or `overview`; a lot of half widths `extent` (2,) [m] fills
    a frame of width over height `aspect`.
    """
    corners = np.array(list(itertools.product((-1, 1), (-1, 1), (0, 1))))
    corners = corners * [*(np.asarray(extent, float) + _MARGIN), _TALL]
    yaw = view_yaw(extent, aspect)
    rise = _ELEVATION[camera]
    right = np.array([math.cos(yaw), math.sin(yaw), 0.0])
    behind = np.array([right[1], -right[0], 0.0])
    back = math.cos(rise) * behind + math.sin(rise) * np.array([0.0, 0.0, 1.0])
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    return fit_eye(corners, axes, _FOVY[camera], aspect), _quaternion(axes)


def add_lot_cameras(spec: mujoco.MjSpec, extent: np.ndarray) -> None:
    """`topdown` and `overview`, both showing the whole lot in a 4:3 frame."""
    for name, fovy in _FOVY.items():
        eye, quat = frame_lot(name, extent, LEAST_ASPECT)
        spec.worldbody.add_camera(name=name, pos=eye, quat=quat, fovy=fovy)


def add_car_cameras(
    car: mujoco.MjsBody, params: VehicleParameters, prefix: str
) -> None:
    """`chase` behind and above a car, and `driver` at its wheel."""
    x = params.centre_offset
    eye = x - params.length - 4.0, 0.0, params.height + 2.6
    add_camera(car, f"{prefix}chase", eye, (x + 2.0, 0.0, 0.3), fovy=60)
    x, y, z = driver_eye(params)
    add_camera(car, f"{prefix}driver", (x, y, z), (x + 10.0, y, z - 0.9), fovy=60)


def add_camera(
    body: mujoco.MjsBody, name: str, eye: Point, target: Point, fovy: float
) -> None:
    """A camera at `eye` looking at `target` in the body's frame, z up."""
    back = np.subtract(eye, target)
    back = back / np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back], axis=1)
    body.add_camera(name=name, pos=eye, quat=_quaternion(axes), fovy=fovy)


def _quaternion(axes: np.ndarray) -> np.ndarray:
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    return quat

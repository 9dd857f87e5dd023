"""What cameras on the first agent's car see, as frames of a recording."""

import dataclasses
import math
from typing import Any, cast

import jax
import numpy as np

from carpark_mj.cameras import RIGS, Heights, Rig, paint, see
from carpark_mj.cameras.colour import Channel
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry.obstacles import Movers, take
from carpark_mj.rendering.recording import Recording
from carpark_mj.types import Motion, State


def car_cameras(camera: str, size: tuple[int, int]) -> Rig | None:
    """The cameras that a flag names, with the resolution of their part of a frame.

    Args:
        camera: a rig by name, or one of its cameras, as `surround:0`.
        size: width and height of a frame [pixels].

    Returns:
        None if there is no rig of that name.

    Raises:
        ValueError: the rig has no such camera, or a frame no room for its cameras.
    """
    name, colon, index = camera.partition(":")
    if name not in RIGS:
        return None
    cameras = RIGS[name].cameras
    if colon:
        if not (index.isdecimal() and int(index) < len(cameras)):
            raise ValueError(
                f"unknown camera {camera!r}; choose {name} or {name}:K with K from 0 "
                f"to {len(cameras) - 1}"
            )
        cameras = (cameras[int(index)],)
    rows, columns = _grid(len(cameras))
    width, height = size[0] // columns, size[1] // rows
    return dataclasses.replace(
        RIGS[name], cameras=cameras, width=width, height=height, shaded=True
    )


class CarCameras:
    """Draws instants of a recording as the cameras of the first agent see them."""

    def __init__(
        self,
        env: ParkingEnv,
        recording: Recording,
        rig: Rig,
        channel: Channel,
        size: tuple[int, int],
    ) -> None:
        """Compiles nothing yet.

        Args:
            env: what was recorded.
            recording: of it.
            rig: `car_cameras` for frames of this size.
            channel: what of their pictures.
            size: width and height of a frame [pixels].
        """
        self._recording, self._size = recording, size
        heights = Heights.of(env.fleet)
        sizes = [(car.length, car.width) for car in env.fleet.agents]
        self._sizes = np.array(sizes, np.float32)

        def draw(state: State) -> jax.Array:
            return paint(see(rig, state, heights, viewers=1), channel)[0]

        self._draw = jax.jit(draw)

    def draw(self, index: int) -> np.ndarray:
        """The recorded instant `index`: all pictures in a grid, (height, width, 3)."""
        pictures = np.asarray(self._draw(_state(self._recording, self._sizes, index)))
        _, columns = _grid(len(pictures))
        height, width = pictures.shape[1:3]
        frame = np.zeros((*self._size[::-1], 3), np.uint8)
        for k, picture in enumerate(pictures):
            y, x = k // columns * height, k % columns * width
            frame[y : y + height, x : x + width] = picture
        return frame


def _grid(count: int) -> tuple[int, int]:
    """Rows and columns for a number of pictures."""
    columns = math.ceil(math.sqrt(count))
    return -(-count // columns), columns


def _state(recording: Recording, sizes: np.ndarray, index: int) -> State:
    """What cameras read of the state at an instant."""
    step, trace = divmod(index, recording.pose_w.shape[1])
    pose_w: Any = recording.pose_w[step, trace]
    kind = None if recording.kind is None else recording.kind[step]
    still: Any = np.zeros_like(pose_w)
    size: Any = sizes[np.zeros(len(pose_w), int) if kind is None else kind]
    motion = Motion(
        pose_w=pose_w,
        velocity_b=still[:, :2],
        yaw_rate=still[:, 0],
        steering=still[:, 0],
        size=size,
        trace_w=pose_w[:, None],
        finite=still[:, 0] == 0.0,
    )
    groups = tuple(take(group, step).instant(trace) for group in recording.movers)
    parked_cars, unread = recording.parked_cars, cast(Any, None)
    assert parked_cars is not None
    return State(
        physics=unread,
        motion=motion,
        layout=recording.layout,
        goal=recording.goal[step],
        tracked_bays=None,
        parked_cars=dataclasses.replace(
            parked_cars, pose_w=recording.parked_pose[step, trace]
        ),
        memory=None,
        step=recording.step[step],
        active=recording.active[step],
        stats=unread,
        sensors=None,
        key=unread,
        kind=kind,
        movers=Movers((), (groups,)),
    )

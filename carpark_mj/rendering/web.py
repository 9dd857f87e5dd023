"""A lot in the browser, through mjviser: driven by sliders, or live by a policy."""

import functools
import importlib.util
import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from carpark_mj.rendering.live import LiveLot
from carpark_mj.rendering.local_pages import HOST, PORT
from carpark_mj.scene.cameras import LEAST_ASPECT, frame_lot
from carpark_mj.scene.materials import ASPHALT, agent_colour
from carpark_mj.scene.parts import GROUND, VERGE_GAP

MISSING_WEB = 'the browser view needs mjviser: pip install "carpark_mj[web]"'
DAYLIGHT = 0.5  # of the environment
GAMMA = 2.2  # of screens
_SLAB = 0.05  # m, thickness of the asphalt in the browser


def require_web() -> None:
    """Raises OSError unless the browser view is installed."""
    if importlib.util.find_spec("mjviser") is None:
        raise OSError(MISSING_WEB)


def make_viewer(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    extent: np.ndarray,
    port: int = PORT,
    step: Callable[[mujoco.MjModel, mujoco.MjData], None] | None = None,
    reset: Callable[[mujoco.MjModel, mujoco.MjData], None] | None = None,
) -> tuple[Any, Any]:
    """Serves a scene on localhost to pages of its own; `run()` keeps it moving.

    Args:
        model: of the scene.
        data: its state.
        extent: (2,) half widths of the lot [m].
        port: where to serve; the next free one if it is taken.
        step: advances `data` by a time step; MuJoCo's own if None.
        reset: restarts; MuJoCo's own if None.

    Returns:
        The viewer of mjviser and its server of viser.

    Raises:
        OSError: mjviser is not installed.
    """
    require_web()
    import mjviser

    from carpark_mj.rendering.local_server import LocalServer

    server = LocalServer(HOST, port, "carpark_mj")
    # mjviser prefers a material's colour to the geom's own, which is the car's.
    model.geom_matid[:] = -1
    # Its meshes travel as glTF, where colours of points are linear.
    model.geom_rgba[:, :3] **= GAMMA
    viewer = mjviser.Viewer(model, data, step_fn=step, reset_fn=reset, server=server)
    viewer.scene.camera_tracking_enabled = False
    server.scene.configure_environment_map(environment_intensity=DAYLIGHT)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    # Planes become grids there, so asphalt replaces the ground.
    server.scene.remove_by_name(f"/fixed_bodies/world/{GROUND}")
    server.scene.add_box(
        "/asphalt",
        _bytes(ASPHALT),
        (2 * (extent[0] + VERGE_GAP), 2 * (extent[1] + VERGE_GAP), _SLAB),
        position=(0.0, 0.0, -_SLAB / 2),
        cast_shadow=False,
    )
    eye, _ = frame_lot("overview", extent, LEAST_ASPECT)
    # mjviser sets its camera when a browser connects, from these.
    viewer.scene.create_scene_gui = functools.partial(
        viewer.scene.create_scene_gui,
        camera_distance=0.65 * float(np.linalg.norm(eye)),
        camera_azimuth=math.degrees(math.atan2(-eye[1], -eye[0])),
        camera_elevation=45.0,
    )
    return viewer, server


def make_live_viewer(lot: LiveLot, port: int = PORT) -> tuple[Any, Any]:
    """Serves a lot in which a policy drives; see `make_viewer`."""
    goals: list[Any] = []

    def show() -> None:
        marks = zip(goals, lot.goal_pose, lot.goal_size, strict=True)
        for goal, pose, size in marks:
            goal.visible = bool(np.isfinite(pose).all())
            if not goal.visible:  # the agent explores
                continue
            goal.dimensions = (float(size[0]) - 0.3, float(size[1]) - 0.3, 0.02)
            goal.position = (float(pose[0]), float(pose[1]), 0.0)
            goal.wxyz = _turn(float(pose[2]))
        words = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in lot.tally())
        tally.content = f"**{lot.seconds:.0f} s**: {words}"

    def step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if lot.step():
            show()

    def reset(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        lot.reset()
        show()

    stage = lot.stage
    viewer, server = make_viewer(
        stage.model, stage.data, np.asarray(lot.extent), port, step, reset
    )
    for agent in range(len(lot.goal_pose)):
        colour = _bytes(agent_colour(agent))
        goals.append(
            server.scene.add_box(
                f"/goals/{agent}", colour, opacity=0.5, cast_shadow=False
            )
        )
    tally = server.gui.add_markdown("")
    show()
    return viewer, server


def _turn(yaw: float) -> tuple[float, float, float, float]:
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def _bytes(colour: tuple[float, ...]) -> tuple[int, int, int]:
    r, g, b = (round(255 * c) for c in colour[:3])
    return r, g, b

"""Pictures of the lots of a batch, off screen or in MuJoCo's window."""

import copy
from typing import Any, Self

import jax
import numpy as np

from carpark_mj.rendering.renderer import LotRenderer, RenderingError, camera_names
from carpark_mj.rendering.snapshot import Snapshot, aimed_at
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.window import NO_DISPLAY, has_display

SIZE = 960, 540  # pixels
RENDER_MODES = ["human", "rgb_array"]


class Screen:
    """Shows lots of one environment; scenes are made anew where layouts differ."""

    def __init__(
        self, env: Any, camera: str = "topdown", num_cars: int | None = None
    ) -> None:
        """Opens nothing yet.

        Args:
            env: a `ParkingEnv`; of subclasses what they draw.
            camera: see `carpark_mj.rendering.renderer.camera_names`.
            num_cars: that cameras can follow; None = the agents.

        Raises:
            ValueError: no such camera.
        """
        camera_names(camera, env.num_agents if num_cars is None else num_cars)
        self._env, self._camera = env, camera
        self._open_nothing()

    def _open_nothing(self) -> None:
        self._shown: list[np.ndarray] = []
        self._stage: Stage | None = None
        self._renderer: LotRenderer | None = None
        self._window: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """Copies open what they show by themselves."""
        opened = ("_shown", "_stage", "_renderer", "_window")
        return {k: v for k, v in vars(self).items() if k not in opened}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open_nothing()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return copy.copy(self)

    def picture(self, state: Any, lot: int = 0) -> np.ndarray:
        """Draws a lot of a batch, (height, width, 3) uint8.

        Raises:
            RenderingError: no OpenGL.
        """
        stage, seen = self._place(state, lot)
        if self._renderer is None:
            self._renderer = LotRenderer(stage, self._camera, SIZE)
        draw, cameras = self._renderer.draw, self._renderer.cameras
        return np.concatenate([draw(seen, name) for name in cameras], axis=1)

    def show(self, state: Any, lot: int = 0) -> None:
        """Shows a lot of a batch in MuJoCo's window.

        Raises:
            RenderingError: there is no display.
        """
        if not has_display():  # MuJoCo's viewer would end the program
            raise RenderingError(
                f"render_mode 'human': {NO_DISPLAY}; 'rgb_array' needs none"
            )
        stage, _ = self._place(state, lot)
        if self._window is None:
            import mujoco.viewer

            self._window = mujoco.viewer.launch_passive(stage.model, stage.data)
        self._window.sync()

    def close(self) -> None:
        """Closes what is open; it opens again if used."""
        for opened in (self._renderer, self._window):
            if opened is not None:
                opened.close()
        self._stage = self._renderer = self._window = None

    def _place(self, state: Any, lot: int) -> tuple[Stage, Snapshot]:
        """The scene of a lot with its cars in their places."""
        parts = state.layout, state.motion, state.parked_cars, state.goal, state.active
        parts = jax.device_get(jax.tree.map(lambda x: x[lot], parts))
        layout, motion, parked_cars, goal, active = parts
        env, drawn = self._env, [*jax.tree.leaves(layout), parked_cars.size]
        same = map(np.array_equal, drawn, self._shown)
        if self._stage is None or not all(same):
            self.close()
            self._shown = drawn
            self._stage = Stage(
                layout,
                env.vehicle,
                env.num_agents,
                env.config.num_parked_cars,
                env.fleet.agents,
                env.fleet.parked_vehicles(parked_cars.size),
            )
        goal_pose, goal_size = aimed_at(layout, goal)
        seen = Snapshot(
            seconds=0.0,
            pose_w=motion.pose_w,
            steering=motion.steering,
            goal_pose=goal_pose,
            goal_size=goal_size,
            parked_pose=parked_cars.pose_w,
            active=active,
            state=(),
            tally={},
            flashes=(),
            size=motion.size,
        )
        self._stage.place(seen.pose_w, seen.steering, seen.parked_pose, seen.size)
        return self._stage, seen

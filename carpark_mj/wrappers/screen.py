"""Pictures of the lots of a batch, off screen or in MuJoCo's window."""

import copy
from collections.abc import Sequence
from typing import Any, Self

import jax
import numpy as np

from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.rendering.renderer import LotRenderer, RenderingError, camera_names
from carpark_mj.rendering.snapshot import Snapshot, aimed_at
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.window import missing_display
from carpark_mj.types import ParkedCars

SIZE = 960, 540  # pixels
RENDER_MODES = ["human", "rgb_array"]


class Screen:
    """Shows lots of one environment; lots that look alike share a scene."""

    def __init__(
        self, env: Any, camera: str = "topdown", num_cars: int | None = None
    ) -> None:
        """Opens nothing yet.

        Args:
            env: a `ParkingEnv`, or what a subclass draws.
            camera: see `carpark_mj.rendering.renderer.camera_names`.
            num_cars: number of cars that cameras can follow; None = the agents.

        Raises:
            ValueError: no such camera.
        """
        camera_names(camera, env.num_agents if num_cars is None else num_cars)
        self._env, self._camera = env, camera
        self._open_nothing()

    def _open_nothing(self) -> None:
        self._stages: dict[bytes, Stage] = {}  # the last is the one used last
        self._renderer: LotRenderer | None = None
        self._window: Any = None
        self._in_window: Stage | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Copies open their own windows and renderers."""
        opened = ("_stages", "_renderer", "_window", "_in_window")
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
        self._renderer.show_lot(stage)
        draw, cameras = self._renderer.draw, self._renderer.cameras
        return np.concatenate([draw(seen, name) for name in cameras], axis=1)

    def show(self, state: Any, lot: int = 0) -> None:
        """Shows a lot of a batch in MuJoCo's window.

        Raises:
            RenderingError: there is no display.
        """
        if missing := missing_display():  # MuJoCo's viewer would end the program
            raise RenderingError(
                f"render_mode 'human': {missing}; 'rgb_array' needs none"
            )
        stage, _ = self._place(state, lot)
        if stage is not self._in_window:
            self._close_window()
            import mujoco.viewer

            self._window = mujoco.viewer.launch_passive(stage.model, stage.data)
            self._in_window = stage
        self._window.sync()

    def close(self) -> None:
        """Closes what is open; it opens again if used."""
        if self._renderer is not None:
            self._renderer.close()
        self._close_window()
        self._renderer, self._stages = None, {}

    def _close_window(self) -> None:
        if self._window is not None:
            self._window.close()
        self._window = self._in_window = None

    def _place(self, state: Any, lot: int) -> tuple[Stage, Snapshot]:
        """The scene of a lot with its cars in their places."""
        names = ("layout", "motion", "parked_cars", "goal", "active", "movers", "kind")
        parts = tuple(getattr(state, name) for name in names)
        parts = jax.device_get(jax.tree.map(lambda x: x[lot], parts))
        layout, motion, parked_cars, goal, active, movers, kind = parts
        stage = self._stage(layout, parked_cars, movers.groups, most=len(state.goal))
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
            kind=kind,
            movers=movers.groups,
        )
        stage.place(
            seen.pose_w, seen.steering, seen.parked_pose, seen.kind, seen.movers
        )
        return stage, seen

    def _stage(
        self,
        layout: Layout,
        parked_cars: ParkedCars,
        movers: Sequence[Group],
        most: int,
    ) -> Stage:
        """The scene of a lot and its parked cars; the `most` used last are kept."""
        looks = parked_cars.size, parked_cars.kind, [group.size for group in movers]
        env, drawn = self._env, jax.tree.leaves((layout, looks))
        key = b"".join(part.tobytes() for part in drawn)
        self._stages[key] = self._stages.pop(key, None) or Stage(
            layout,
            env.vehicle,
            env.num_agents,
            env.config.num_parked_cars,
            env.fleet.agents,
            env.fleet.parked_vehicles(parked_cars),
            movers,
        )
        if len(self._stages) > most:
            del self._stages[next(iter(self._stages))]
        return self._stages[key]

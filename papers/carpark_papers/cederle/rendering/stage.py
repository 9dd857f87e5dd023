"""The scene of a junction with its cars put where they are; needs no OpenGL."""

import jax
import mujoco
import numpy as np

from carpark_mj.rendering.snapshot import Snapshot
from carpark_mj.rendering.stage import Stage
from carpark_mj.types import Motion
from carpark_mj.vehicle import VehicleParameters
from carpark_papers.cederle.junction.roads import LANE_WIDTH
from carpark_papers.cederle.junction.scene import add_paint, plan
from carpark_papers.cederle.junction.types import State

_FAR = -500.0  # m, where cars are put that have left


class JunctionStage(Stage):
    """The scene of a junction with its cars put where they are.

    Human-driven cars are its last agents.
    """

    def __init__(self, params: VehicleParameters, num_cars: int) -> None:
        """Compiles the scene."""
        super().__init__(plan(), params, num_cars, 0)

    def build(self) -> mujoco.MjSpec:
        """The scene, with its paint."""
        spec = super().build()
        add_paint(spec)
        return spec

    def snapshot(self, state: State) -> Snapshot:
        """Puts the cars of a state (no batch dimension) in their places.

        Returns:
            The instant for `LotRenderer`; cars that have left are far off.
        """
        present = np.asarray(state.present)
        motion: Motion = jax.device_get(state.motion)
        pose = np.where(present[:, None], np.asarray(motion.pose_w, float), _FAR)
        goals = np.asarray(state.task.goal_xy, float)
        goal_pose = np.full((len(pose), 3), np.nan)
        goal_pose[: len(goals)] = np.pad(goals, ((0, 0), (0, 1)))
        active = present.copy()
        active[: len(goals)] = state.active
        seen = Snapshot(
            seconds=0.0,
            pose_w=pose,
            steering=np.asarray(motion.steering, float),
            goal_pose=goal_pose,
            goal_size=np.full((len(pose), 2), LANE_WIDTH),
            parked_pose=np.zeros((0, 3)),
            active=active,
            state=(),
            tally={},
            flashes=(),
        )
        self.place(seen.pose_w, seen.steering, seen.parked_pose)
        return seen

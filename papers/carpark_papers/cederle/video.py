"""A video of episodes at the junction, labelled with the agents' intentions."""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import jax
import mujoco
import numpy as np

from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.stage import Snapshot, Stage
from carpark_mj.rendering.video import draw_labels, draw_status, write_video
from carpark_mj.types import Motion
from carpark_mj.vehicle import VehicleParameters, preset
from carpark_papers.cederle.junction.cars import road_car
from carpark_papers.cederle.junction.config import JunctionConfig
from carpark_papers.cederle.junction.evaluation import car_names
from carpark_papers.cederle.junction.roads import LANE_WIDTH
from carpark_papers.cederle.junction.rules import ACTIONS, State
from carpark_papers.cederle.junction.scene import add_paint, plan

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
        self.place(seen)
        return seen


SIZE = 720, 720  # pixels
STILL = 1.0  # s for which the end of an episode is shown
# Events that end an agent's episode, in the order in which they are looked for.
ENDS = ("crashed", "arrived", "off_road", "off_route", "timed_out", "diverged")


@dataclasses.dataclass(frozen=True)
class Drive:
    """An episode as it went."""

    states: Sequence[State]  # after each control step, on the host, without images
    actions: Sequence[np.ndarray]  # (num_agents,) indices of `ACTIONS` that led there
    # (num_agents, len(ENDS)) bool, which of `ENDS` had happened by then
    ended: Sequence[np.ndarray]


def write_drives(path: Path, config: JunctionConfig, drives: Sequence[Drive]) -> Path:
    """Draws episodes one after the other, from above, in real time.

    Below its disc stands what a car intends, or how its episode ended; a line leads to
    its goal.
    """
    missing_gl = choose_gl()
    if missing_gl:
        raise RenderingError(missing_gl)
    names = car_names(config.traffic)
    stage = JunctionStage(road_car(preset(config.vehicle)), len(names))
    renderer = LotRenderer(stage, "topdown", SIZE)
    traces, dt = config.sim.num_traces, config.sim.ctrl_dt

    def frames() -> Iterator[np.ndarray]:
        for drive in drives:
            order = drive.states[0].task.order
            own = names if order is None else [names[k] for k in order]
            frame = np.zeros((0, 0, 3), np.uint8)
            for step in range(len(drive.states)):
                for trace in range(traces):
                    seen = _snapshot(stage, drive, step, trace, own)
                    seconds = dt * (step + (trace + 1) / traces)
                    seen = dataclasses.replace(seen, seconds=seconds)
                    renderer.place(seen)
                    picture = renderer.draw(seen, "topdown")
                    frame = draw_labels(picture, renderer, seen, "topdown")
                    frame = draw_status(frame, seen)
                    yield frame
            for _ in range(round(STILL / dt) * traces):
                yield frame

    try:
        write_video(path, frames(), traces / dt)
    finally:
        renderer.close()
    return path


def _snapshot(
    stage: JunctionStage, drive: Drive, step: int, trace: int, names: Sequence[str]
) -> Snapshot:
    """One traced instant of a control step."""
    state = drive.states[step]
    motion = state.motion
    pose = np.asarray(motion.trace_w)[:, trace]
    state = dataclasses.replace(state, motion=dataclasses.replace(motion, pose_w=pose))
    words = [
        f"{name}: {_intention(drive, step, k)}, {round(float(speed))} m/s"
        for k, (name, speed) in enumerate(zip(names, motion.speed, strict=True))
    ]
    tally = {"crashed": float(drive.ended[step][:, ENDS.index("crashed")].sum())}
    return dataclasses.replace(stage.snapshot(state), state=tuple(words), tally=tally)


def _intention(drive: Drive, step: int, agent: int) -> str:
    """What an agent is up to, or how its episode ended."""
    if agent >= len(drive.actions[step]):  # human-driven
        return "keep lane"
    ends = np.flatnonzero(drive.ended[step][agent])
    word = ENDS[ends[0]] if len(ends) else ACTIONS[drive.actions[step][agent]]
    return word.replace("_", " ")

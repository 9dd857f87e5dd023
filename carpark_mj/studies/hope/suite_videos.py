"""Short videos of driven cases of the suite."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.evaluation.aggregation import Row
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import Recording
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.snapshot import frames_per_second, num_frames
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.video import draw_frame, write_video
from carpark_mj.studies.hope.suite import Drives, suite_env
from carpark_mj.studies.hope.suite_cases import case_numbers, pick_cases
from carpark_mj.studies.hope.suite_files import Key, key_of
from carpark_mj.types import OUTCOMES
from carpark_mj.vehicle import preset

SIZE = (640, 400)  # pixels
FASTER = 4  # times: 100 s last 25 s
FPS = 10.0
END = 10  # frames that the last one stays
FOLDER = "videos"


class Video(NamedTuple):
    """A video of an episode.

    Attributes:
        row: the episode.
        path: the file.
    """

    row: Row
    path: Path


def require_gl() -> None:
    """Refuses to draw without OpenGL.

    Raises:
        RenderingError: there is none.
    """
    if missing := choose_gl():
        raise RenderingError(missing)


def make_videos(
    folder: Path, rows: Sequence[Row], drives: Mapping[Key, Drives]
) -> list[Video]:
    """Draws episodes from above, `FASTER` times as fast as driven.

    Args:
        folder: the videos' folder is made in it.
        rows: the episodes.
        drives: their driven paths.

    Raises:
        RenderingError: there is no OpenGL.
    """
    videos = []
    for row in rows:
        policy = quote(row["policy"], safe="")  # of runs the whole path
        name = f"{policy}-{row['level']}-{row['seed']}-{row['case']}.mp4"
        path = folder / FOLDER / name
        path.parent.mkdir(exist_ok=True)
        _write(path, recording_of(row, drives[key_of(row)]))
        videos.append(Video(row, path))
    return videos


def recording_of(row: Row, drive: Drives) -> Recording:
    """An episode as the renderer takes it."""
    steps, agents = round(row["length"]), drive.speed.shape[-1]
    first = np.broadcast_to(np.arange(agents) == 0, (steps, agents))  # the one judged
    place = case_numbers(row["level"]).index(row["case"])
    cases = pick_cases(row["level"], 1, place, agents > 1)
    pose_w = drive.pose_w[0, :steps].swapaxes(1, 2)
    ends = {
        name: first & (np.arange(steps) == steps - 1)[:, None] & bool(row[name])
        for name in OUTCOMES
    }
    return Recording(
        layout=jax.tree.map(lambda x: np.asarray(x[0]), cases.layouts),
        ctrl_dt=suite_env(EnvConfig(), "strict").sim.ctrl_dt,
        pose_w=pose_w,
        steering=drive.steering[0, :steps],
        speed=drive.speed[0, :steps],
        goal=np.broadcast_to(np.arange(agents), (steps, agents)),
        parked_pose=np.zeros((*pose_w.shape[:2], 0, 3), np.float32),
        active=np.ones((steps, agents), bool),
        step=np.broadcast_to(np.arange(1, steps + 1)[:, None], (steps, agents)),
        **ends,
    )


def _write(path: Path, recording: Recording) -> None:
    stage = Stage(recording.layout, preset("tpcap"), recording.speed.shape[1], 0)
    renderer = LotRenderer(stage, "topdown", SIZE)
    stride = max(1, round(FASTER * frames_per_second(recording) / FPS))
    last = num_frames(recording) - 1
    indices = [*range(stride - 1, last, stride), *[last] * END]
    try:
        pictures = (draw_frame(recording, renderer, index) for index in indices)
        write_video(path, pictures, FASTER * frames_per_second(recording) / stride)
    finally:
        renderer.close()

"""A video of a trained policy: an episode on every kind of lot."""

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.policy.networks import Policy
from carpark_mj.rendering.gl import choose_gl
from carpark_mj.rendering.recording import Recording, record, recording_stage
from carpark_mj.rendering.renderer import LotRenderer, RenderingError
from carpark_mj.rendering.snapshot import num_frames
from carpark_mj.rendering.video import draw_frame, frame_stride, write_video
from carpark_mj.wrappers.goal import GoalParking
from carpark_mj.wrappers.options import share
from carpark_papers.pandita.sac.deploy import choose_action
from carpark_papers.pandita.sac.train import Training

FPS = 10.0
SIZE = (960, 540)
STILL = 1.0  # s for which the end of an episode is shown


def write_drives(training: Training, path: Path) -> Path:
    """Renders the deterministic policy; every kind has its share of the time.

    Raises:
        RenderingError: no GL.
    """
    config, policy = training.config, training.agent.policy
    missing_gl = choose_gl()
    if missing_gl:
        raise RenderingError(missing_gl)
    seconds = config.video_seconds / len(config.kinds)

    def act(vector: jax.Array, key: jax.Array) -> tuple[jax.Array, dict[str, Any]]:
        params = policy.actor_state.params
        return choose_action(policy.actor.apply, False, params, vector, key), {}

    def pictures() -> Iterator[np.ndarray]:
        for kind in config.kinds:
            env = share(GoalParking, config.env_of(config.layout(kind)))
            yield from _draw(env, act, seconds, config.seed)

    frames = pictures()
    first = next(frames)
    write_video(path, itertools.chain([first], frames), FPS)
    return path


def _draw(
    env: GoalParking, act: Policy, seconds: float, seed: int
) -> Iterator[np.ndarray]:
    """Frames of an episode, till `STILL` after its end."""
    num_steps = max(1, round(seconds / env.config.sim.ctrl_dt))
    recording = _until_still(record(env, act, num_steps, seed))
    renderer = LotRenderer(recording_stage(env, recording), "topdown", SIZE)
    try:
        stride = frame_stride(recording, FPS)
        for index in range(stride - 1, num_frames(recording), stride):
            yield draw_frame(recording, renderer, index)
    finally:
        renderer.close()


def _until_still(recording: Recording) -> Recording:
    """The steps of the episode, and a few after its end."""
    length = int(recording.active.any(axis=1).sum())
    length += round(STILL / recording.ctrl_dt)
    cut = {
        field.name: value[:length]
        for field in dataclasses.fields(recording)
        if field.name not in ("layout", "ctrl_dt", "parked_size")
        and (value := getattr(recording, field.name)) is not None
    }
    return dataclasses.replace(recording, **cut)

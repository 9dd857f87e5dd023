"""Frames of a recording, and writing them as mp4."""

import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from carpark_mj.policy.checkpoints import write_atomically
from carpark_mj.rendering.overlays import draw_labels, draw_status
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.rollout import Recording


def num_frames(recording: Recording) -> int:
    """Poses recorded, one after every traced instant."""
    return recording.pose_w.shape[0] * recording.pose_w.shape[1]


def draw_frame(recording: Recording, renderer: LotRenderer, index: int) -> np.ndarray:
    """Draws one recorded instant, (height, width, 3) uint8."""
    step, trace = divmod(index, recording.pose_w.shape[1])
    pose, goal = recording.pose_w[step, trace], recording.goal[step]
    frame = renderer.render(
        pose, recording.steering[step], goal, recording.parked_pose[step]
    )
    bay_pose = np.asarray(recording.layout.bay_pose)
    frame = draw_labels(frame, renderer, pose, bay_pose[goal])
    # What happens in a step is counted when it is over.
    over = (index + 1) // recording.pose_w.shape[1]
    counts = "   ".join(
        f"{name} {events[:over].sum()}"
        for name, events in (
            ("parked", recording.parked),
            ("crashed", recording.crashed),
            ("timed out", recording.timed_out),
        )
    )
    seconds = (index + 1) / frames_per_second(recording)
    return draw_status(frame, [f"{seconds:5.1f} s", counts])


def frames_per_second(recording: Recording) -> float:
    """Frame rate at which all frames of a recording play in real time."""
    return recording.pose_w.shape[1] / recording.ctrl_dt


def frame_stride(recording: Recording, fps: float) -> int:
    """Every how many frames to draw to come closest to a wanted rate."""
    return max(1, round(frames_per_second(recording) / fps))


def write_mp4(path: Path, pictures: Iterator[np.ndarray], fps: float) -> int:
    """Encodes frames as H.264 and returns their number; the file appears whole."""
    import imageio_ffmpeg

    first = next(pictures)
    count = 1

    def write(temporary: Path) -> None:
        nonlocal count
        writer = imageio_ffmpeg.write_frames(
            str(temporary),
            (first.shape[1], first.shape[0]),
            fps=fps,  # pyright: ignore[reportArgumentType]
            codec="libx264",
            quality=None,  # pyright: ignore[reportArgumentType]
            output_params=["-crf", "23", "-preset", "veryfast"],
            macro_block_size=2,
        )
        writer.send(None)
        try:
            writer.send(np.ascontiguousarray(first))
            for picture in pictures:
                writer.send(np.ascontiguousarray(picture))
                count += 1
        finally:
            writer.close()

    with warnings.catch_warnings():
        # JAX warns of forks; the encoder is another program and touches no JAX.
        warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called")
        write_atomically(path, write)
    return count

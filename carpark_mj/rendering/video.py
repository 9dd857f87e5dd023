"""Frames of a recording with labels or from a car's cameras, as mp4 or GIF."""

import contextlib
import dataclasses
import itertools
import subprocess
from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np

from carpark_mj.cameras import Heights, Rig, paint, see
from carpark_mj.cameras.rig import picture_grid
from carpark_mj.cameras.see import Channel
from carpark_mj.env import ParkingEnv
from carpark_mj.files import require_suffix, write_atomically
from carpark_mj.geometry.obstacles import Movers, take
from carpark_mj.rendering.recording import (
    Recording,
    frames_per_second,
    num_frames,
    snapshot,
)
from carpark_mj.rendering.renderer import FLASH_COLOURS, LotRenderer
from carpark_mj.rendering.stage import Snapshot
from carpark_mj.scene.looks import agent_colour, rgb
from carpark_mj.types import Motion

Colour = tuple[int, int, int]

LABEL_HEIGHT = 1.7  # m, above a car's roof
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (15, 15, 15)
BEHIND_TEXT = (10, 10, 12, 190)  # behind text


@cache
def font(pixels: int) -> Any:
    """The font of all captions, this many pixels high."""
    from PIL import ImageFont

    return ImageFont.load_default(pixels)


def draw_labels(
    frame: np.ndarray, renderer: LotRenderer, seen: Snapshot, camera: str
) -> np.ndarray:
    """Labels agents with discs and goals with squares, both with the agent's index.

    What the agent does, or how its episode has ended, stands below its disc, and for a
    moment where one has just ended. Returns a new frame (height, width, 3) uint8.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    radius = max(9, round(max(frame.shape[:2]) / 80))
    large, small = font(round(radius * 1.5)), font(round(radius * 1.15))
    pad, line = round(radius / 3), max(2, round(radius / 6))

    def tag(x: float, y: float, text: str, ink: Colour) -> None:
        _write(draw, (x, y), text, ink, pad, font=small, anchor="mt")

    for flash in seen.flashes:
        pixel = renderer.project(np.array([*flash.pose_w[:2], LABEL_HEIGHT]), camera)
        if pixel is not None:
            text = f"{flash.agent} {flash.outcome.replace('_', ' ')}"
            colour = rgb(FLASH_COLOURS[flash.outcome])
            tag(pixel[0], pixel[1] - 3 * radius, text, colour)
    for agent, state in enumerate(seen.state):
        colour = rgb(agent_colour(agent))
        for pose, height, shape in (
            (seen.goal_pose[agent], 0.0, draw.rectangle),
            (seen.pose_w[agent], LABEL_HEIGHT, draw.ellipse),
        ):
            if np.isnan(pose).any():  # of an agent that explores
                continue
            pixel = renderer.project(np.array([pose[0], pose[1], height]), camera)
            if pixel is None:
                continue
            x, y = pixel
            box = (x - radius, y - radius, x + radius, y + radius)
            shape(box, fill=colour, outline=WHITE, width=line)
            # What reads better on the colour (luma of ITU-R BT.601).
            ink = BLACK if np.dot((0.299, 0.587, 0.114), colour) > 140 else WHITE
            draw.text((x, y), str(agent), ink, font=large, anchor="mm")
            if shape == draw.ellipse and state:
                tag(x, y + radius + pad, state, WHITE)
    return np.asarray(image)


def draw_status(frame: np.ndarray, seen: Snapshot) -> np.ndarray:
    """Writes clock and tallies into the top left corner."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    size = max(12, round(max(frame.shape[:2]) / 40))
    tallies = [f"{name.replace('_', ' ')} {n}" for name, n in seen.tally.items()]
    text = "\n".join([f"{seen.seconds:.1f} s", *tallies])
    corner = (size * 0.9, size * 0.7)
    _write(draw, corner, text, WHITE, size * 0.4, font=font(size))
    return np.asarray(image)


def _write(
    draw: Any, at: tuple[float, float], text: str, ink: Colour, pad: float, **style: Any
) -> None:
    """Writes lines on a dark ground that is wider than these by `pad`."""
    left, top, right, low = draw.textbbox(at, text, **style)
    ground = (left - pad, top - pad, right + pad, low + pad)
    draw.rounded_rectangle(ground, pad, fill=BEHIND_TEXT)
    draw.text(at, text, ink, **style)


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
        """Compiles nothing yet; the rig is `car_cameras` for frames of this size."""
        self._recording, self._size = recording, size
        heights = Heights.of(env.fleet)
        sizes = [(car.length, car.width) for car in env.fleet.agents]
        self._sizes: Any = np.array(sizes, np.float32)

        def draw(parts: dict[str, Any]) -> jax.Array:
            state: Any = SimpleNamespace(**parts)  # what cameras read of it
            return paint(see(rig, state, heights, viewers=1), channel)[0]

        self._draw = jax.jit(draw)

    def draw(self, index: int) -> np.ndarray:
        """The recorded instant `index`: all pictures in a grid, (height, width, 3)."""
        pictures = np.asarray(self._draw(self._seen(index)))
        _, columns = picture_grid(len(pictures))
        height, width = pictures.shape[1:3]
        frame = np.zeros((*self._size[::-1], 3), np.uint8)
        for k, picture in enumerate(pictures):
            y, x = k // columns * height, k % columns * width
            frame[y : y + height, x : x + width] = picture
        return frame

    def _seen(self, index: int) -> dict[str, Any]:
        recording = self._recording
        step, trace = divmod(index, recording.pose_w.shape[1])
        pose_w: Any = recording.pose_w[step, trace]
        kind = None if recording.kind is None else recording.kind[step]
        still: Any = np.zeros_like(pose_w)
        motion = Motion(
            pose_w=pose_w,
            velocity_b=still[:, :2],
            yaw_rate=still[:, 0],
            steering=still[:, 0],
            size=self._sizes[still[:, 0].astype(int) if kind is None else kind],
            trace_w=pose_w[:, None],
            finite=still[:, 0] == 0.0,
        )
        groups = tuple(take(group, step).instant(trace) for group in recording.movers)
        parked: Any = recording.parked_cars
        parked_pose = recording.parked_pose[step, trace]
        return {
            "motion": motion,
            "layout": recording.layout,
            "goal": recording.goal[step],
            "parked_cars": dataclasses.replace(parked, pose_w=parked_pose),
            "kind": kind,
            "movers": Movers((), (groups,)),
        }


def draw_frame(recording: Recording, renderer: LotRenderer, index: int) -> np.ndarray:
    """Draws one recorded instant with its labels, (height, width, 3) uint8."""
    seen = snapshot(recording, index)
    renderer.place(seen)
    return draw_labelled(seen, renderer)


def draw_labelled(seen: Snapshot, renderer: LotRenderer) -> np.ndarray:
    """Draws an instant with labels and status, (height, width, 3) uint8."""
    views = [
        draw_labels(renderer.draw(seen, camera), renderer, seen, camera)
        for camera in renderer.cameras
    ]
    views[-1] = draw_status(views[-1], seen)
    return np.concatenate(views, axis=1)


def frame_indices(
    recording: Recording, fps: float, faster: float = 1.0, hold: int = 0
) -> tuple[list[int], float]:
    """Which recorded instants a video shows, and its frames per second, as near `fps`.

    It plays `faster` times as fast as driven; its end is shown `hold` frames longer.
    The shortest is one frame.
    """
    rate, count = faster * frames_per_second(recording), num_frames(recording)
    stride = min(max(1, round(rate / fps)), count)
    return [*range(stride - 1, count, stride), *[count - 1] * hold], rate / stride


# All frames of a GIF share a palette, which needs no dithering.
_GIF = "split[a][b];[a]palettegen=128[p];[b][p]paletteuse=dither=none"


def write_video(path: Path, pictures: Iterator[np.ndarray], fps: float) -> int:
    """Writes frames, atomically, as `.mp4` or looping `.gif`; returns their number.

    Raises:
        OSError: the file cannot be written, or FFmpeg refuses the frame rate.
    """
    import imageio_ffmpeg

    require_suffix("a video", path.name, ".mp4", ".gif")
    first, count = next(pictures), 0
    height, width = first.shape[:2]
    rate = str(Fraction(fps).limit_denominator())
    given = f"-f rawvideo -pix_fmt rgb24 -s {width}x{height} -r {rate} -i -"
    if path.suffix == ".gif":
        coded = f"-vf {_GIF}"
    else:  # H.264 takes even widths and heights only
        even = f"-vf scale={width + width % 2}:{height + height % 2} -pix_fmt yuv420p"
        coded = f"{even} -c:v libx264 -crf 23 -preset veryfast"
    program = [imageio_ffmpeg.get_ffmpeg_exe(), *f"{given} {coded} -v quiet -y".split()]

    def write(temporary: Path) -> None:
        nonlocal count
        encoder = subprocess.Popen(
            [*program, str(temporary)],
            stdin=subprocess.PIPE,
            process_group=0,  # Ctrl-C is for us
        )
        assert encoder.stdin is not None
        try:
            # Of a pipe that breaks the exit status tells.
            with contextlib.suppress(BrokenPipeError), encoder.stdin:
                for picture in itertools.chain([first], pictures):
                    encoder.stdin.write(np.ascontiguousarray(picture).data)
                    count += 1
        except BaseException:  # do not wait for FFmpeg
            encoder.kill()
            raise
        finally:
            failed = encoder.wait()
        if failed:
            raise OSError(
                f"FFmpeg stopped while it wrote {path} at {fps:g} frames per second; "
                "is the disk full, or this rate impossible?"
            )

    write_atomically(path, write)
    return count

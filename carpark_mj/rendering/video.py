"""Frames of a recording, and writing them as mp4 or GIF."""

import contextlib
import re
import subprocess
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from carpark_mj.files import write_atomically
from carpark_mj.rendering.overlays import draw_labels, draw_status
from carpark_mj.rendering.recording import Recording
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.snapshot import frames_per_second, num_frames, snapshot

GIF_GREYS, GIF_COLOURS = 48, 144  # palette entries
CHROMA = 40  # of 255; less is grey


def draw_frame(recording: Recording, renderer: LotRenderer, index: int) -> np.ndarray:
    """Draws one recorded instant with its labels, (height, width, 3) uint8."""
    seen = snapshot(recording, index)
    renderer.place(seen)
    views = [
        draw_labels(renderer.draw(seen, camera), renderer, seen, camera)
        for camera in renderer.cameras
    ]
    views[-1] = draw_status(views[-1], seen)
    return np.concatenate(views, axis=1)


def frame_stride(recording: Recording, fps: float) -> int:
    """Every how many frames to draw to come closest to a wanted rate.

    No more than there are: the shortest video is one frame.
    """
    wanted = round(frames_per_second(recording) / fps)
    return min(max(1, wanted), num_frames(recording))


def write_video(path: Path, pictures: Iterator[np.ndarray], fps: float) -> int:
    """Writes frames as `.mp4` or `.gif` by the path's suffix; returns their number.

    The file is written atomically.

    Raises:
        ValueError: another suffix.
        OSError: the file cannot be written, or FFmpeg refuses the frame rate.
    """
    if path.suffix == ".mp4":
        return _write_mp4(path, pictures, fps)
    if path.suffix == ".gif":
        return _write_gif(path, pictures, fps)
    raise ValueError(f"a video ends in .mp4 or .gif, not {path.name!r}")


def _write_mp4(path: Path, pictures: Iterator[np.ndarray], fps: float) -> int:
    """Encodes frames as H.264."""
    import imageio_ffmpeg

    first = next(pictures)
    count = 1
    stopped = (
        f"FFmpeg stopped while it wrote {path} at {fps:g} frames per second; "
        "is the disk full, or this rate impossible?"
    )

    def send(writer: Any, picture: np.ndarray) -> None:
        try:
            writer.send(np.ascontiguousarray(picture))
        except OSError as error:  # it quotes FFmpeg's whole command line
            raise OSError(stopped) from error

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
            ffmpeg_log_level="quiet",  # errors are told below
        )
        writer.send(None)
        try:
            send(writer, first)
            for picture in pictures:
                send(writer, picture)
                count += 1
        except KeyboardInterrupt as error:  # do not wait for FFmpeg
            with contextlib.suppress(KeyboardInterrupt):
                writer.throw(error)
            raise
        finally:
            writer.close()
        if _num_encoded(temporary) != count:  # its exit code is not ours to see
            raise OSError(stopped)

    with warnings.catch_warnings():
        # JAX warns of forks; the encoder is another program and touches no JAX.
        warnings.filterwarnings("ignore", message=r"os\.fork\(\) was called")
        write_atomically(path, write)
    return count


def _num_encoded(path: Path) -> int:
    """How many frames a video has; 0 where there is none."""
    import imageio_ffmpeg

    program = imageio_ffmpeg.get_ffmpeg_exe()
    copy = ("-map", "0:v:0", "-c", "copy", "-f", "null", "-")
    told = subprocess.run(
        [program, "-nostdin", "-i", str(path), *copy],
        capture_output=True,
        text=True,
        errors="replace",
        check=False,
    )
    counts = re.findall(r"frame= *(\d+)", told.stderr)
    return int(counts[-1]) if counts else 0


def _write_gif(path: Path, pictures: Iterator[np.ndarray], fps: float) -> int:
    """Writes a looping GIF; all frames share the palette of a few of them."""
    from PIL import Image

    frames = list(pictures)
    palette = _palette(np.concatenate(frames[:: max(1, len(frames) // 4)]))
    flat = [
        Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE)
        for f in frames
    ]
    duration = round(1000 / fps)  # ms per frame; GIF counts in hundredths of a second
    write_atomically(
        path,
        lambda temporary: flat[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=flat[1:],
            duration=duration,
            loop=0,
            optimize=True,
        ),
    )
    return len(flat)


def _palette(picture: np.ndarray) -> Any:
    """A palette with a share of its own for colours: a car park is mostly grey."""
    from PIL import Image

    pixels = picture.reshape(-1, 3)
    grey = np.ptp(pixels.astype(int), axis=1) < CHROMA
    entries = []
    for some, count in ((pixels[grey], GIF_GREYS), (pixels[~grey], GIF_COLOURS)):
        if len(some):
            part = Image.fromarray(some[None]).quantize(count)
            entries += (part.getpalette() or [])[: 3 * count]
    palette = Image.new("P", (1, 1))
    palette.putpalette(entries)
    return palette

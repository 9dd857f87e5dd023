"""Pictures of a live lot: in a window, and as a video."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from carpark_mj.play.driven import DrivenLot
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.video import draw_labels, draw_status, write_video

SIZE = (1280, 720)  # pixels


class Picture:
    """Draws a lot with labels, clock, tallies and score."""

    def __init__(self, lot: DrivenLot, camera: str) -> None:
        """Opens a GL context.

        Raises:
            RenderingError: no GL.
            ValueError: no such camera.
        """
        self._lot = lot
        self._renderer = LotRenderer(lot.stage, camera, SIZE)

    def draw(self) -> np.ndarray:
        """The present instant, (height, width, 3) uint8."""
        seen, renderer = self._lot.snapshot(), self._renderer
        views = [
            draw_labels(renderer.draw(seen, camera), renderer, seen, camera)
            for camera in renderer.cameras
        ]
        views[-1] = draw_status(views[-1], seen)
        return np.concatenate(views, axis=1)

    def close(self) -> None:
        """Frees the GL context."""
        self._renderer.close()


def record_video(lot: DrivenLot, camera: str, steps: int, path: Path) -> int:
    """Writes `steps` control steps as a video; returns the number of frames.

    Raises:
        RenderingError: no GL.
        ValueError: no such camera, or another suffix than .mp4 or .gif.
    """
    picture = Picture(lot, camera)

    def frames() -> Iterator[np.ndarray]:
        for _ in range(steps * lot.traces):
            lot.step()
            yield picture.draw()

    try:
        return write_video(path, frames(), 1.0 / lot.stage.model.opt.timestep)
    finally:
        picture.close()

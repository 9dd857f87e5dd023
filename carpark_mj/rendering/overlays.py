"""Text drawn over a frame: agents, goals, recent events, clock, tallies."""

from functools import cache
from typing import Any

import numpy as np

from carpark_mj.rendering.renderer import FLASH_COLOURS, LotRenderer
from carpark_mj.rendering.snapshot import Snapshot
from carpark_mj.scene.materials import agent_colour

Colour = tuple[int, int, int]

LABEL_HEIGHT = 1.7  # m, above a car's roof
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (15, 15, 15)
GROUND = (10, 10, 12, 190)  # behind text


@cache
def font(pixels: int) -> Any:
    """The font of all captions, this many pixels high."""
    from PIL import ImageFont

    return ImageFont.load_default(pixels)


def _rgb(colour: tuple[float, ...]) -> Colour:
    r, g, b = (round(255 * c) for c in colour[:3])
    return r, g, b


def _ink(colour: Colour) -> Colour:
    """Black or white, whichever reads better on the colour (ITU-R BT.601 luma)."""
    luma = 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2]
    return BLACK if luma > 140 else WHITE


def draw_labels(
    frame: np.ndarray, renderer: LotRenderer, seen: Snapshot, camera: str
) -> np.ndarray:
    """Labels agents with discs and goals with squares, both with the agent's index.

    What the agent does, or how its episode has ended, stands below its disc, and for
    a moment where an episode has just ended.

    Args:
        frame: (height, width, 3) uint8.
        renderer: which drew it.
        seen: what it shows.
        camera: by which it was drawn.

    Returns:
        A new frame.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    radius = max(9, round(renderer.height / 55))
    large, small = font(round(radius * 1.5)), font(round(radius * 1.15))

    def tag(x: float, y: float, text: str, ink: Colour) -> None:
        box = draw.textbbox((x, y), text, font=small, anchor="mt")
        draw.rounded_rectangle(
            (box[0] - 3, box[1] - 2, box[2] + 3, box[3] + 2), 3, fill=GROUND
        )
        draw.text((x, y), text, ink, font=small, anchor="mt")

    for flash in seen.flashes:
        pixel = renderer.project(np.array([*flash.pose_w[:2], LABEL_HEIGHT]), camera)
        if pixel is not None:
            text = f"{flash.agent} {flash.outcome.replace('_', ' ')}"
            tag(
                pixel[0],
                pixel[1] - 3 * radius,
                text,
                _rgb(FLASH_COLOURS[flash.outcome]),
            )
    for agent, state in enumerate(seen.state):
        colour = _rgb(agent_colour(agent))
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
            shape(box, fill=colour, outline=WHITE, width=2)
            draw.text((x, y), str(agent), _ink(colour), font=large, anchor="mm")
            if shape == draw.ellipse and state:
                tag(x, y + radius + 3, state, WHITE)
    return np.asarray(image)


def draw_status(frame: np.ndarray, seen: Snapshot) -> np.ndarray:
    """Writes clock and tallies into the top left corner."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    size = max(12, round(frame.shape[0] / 40))
    tallies = [f"{name.replace('_', ' ')} {n}" for name, n in seen.tally.items()]
    text = "\n".join([f"{seen.seconds:.1f} s", *tallies])
    corner = (size * 0.9, size * 0.7)
    box = draw.multiline_textbbox(corner, text, font=font(size))
    pad = size * 0.4
    ground = (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad)
    draw.rounded_rectangle(ground, pad, fill=GROUND)
    draw.multiline_text(corner, text, WHITE, font=font(size))
    return np.asarray(image)

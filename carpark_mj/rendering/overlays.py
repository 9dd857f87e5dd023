"""What is written over a frame: indices of agents and goals, clock and tallies."""

from functools import cache
from typing import Any

import numpy as np

from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.scene.materials import agent_colour

Colour = tuple[int, int, int]

LABEL_HEIGHT = 1.7  # m, above a car's roof
WHITE: Colour = (255, 255, 255)
BLACK: Colour = (15, 15, 15)


@cache
def _font(pixels: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(pixels)


def _rgb(agent: int) -> Colour:
    r, g, b = (round(255 * c) for c in agent_colour(agent)[:3])
    return r, g, b


def _ink(colour: Colour) -> Colour:
    """Black or white, whichever reads better on the colour (ITU-R BT.601 luma)."""
    luma = 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2]
    return BLACK if luma > 140 else WHITE


def draw_labels(
    frame: np.ndarray,
    renderer: LotRenderer,
    pose_w: np.ndarray,
    goal_pose: np.ndarray,
) -> np.ndarray:
    """Labels agents with discs and goals with squares, both with the agent's index.

    Args:
        frame: (height, width, 3) uint8.
        renderer: which drew it.
        pose_w: (agents, 3).
        goal_pose: (agents, 3).

    Returns:
        A new frame.
    """
    from PIL import Image, ImageDraw

    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image)
    radius = max(9, round(renderer.height / 55))
    font = _font(round(radius * 1.5))
    for agent in range(len(pose_w)):
        colour = _rgb(agent)
        for pose, height, shape in (
            (goal_pose[agent], 0.0, draw.rectangle),
            (pose_w[agent], LABEL_HEIGHT, draw.ellipse),
        ):
            pixel = renderer.project(np.array([pose[0], pose[1], height]))
            if pixel is None:
                continue
            x, y = pixel
            box = (x - radius, y - radius, x + radius, y + radius)
            shape(box, fill=colour, outline=WHITE, width=2)
            draw.text((x, y), str(agent), _ink(colour), font=font, anchor="mm")
    return np.asarray(image)


def draw_status(frame: np.ndarray, lines: list[str]) -> np.ndarray:
    """Writes lines of text into the top left corner on a dark ground."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    size = max(12, round(frame.shape[0] / 36))
    text = "\n".join(lines)
    box = draw.multiline_textbbox((size, size * 0.8), text, font=_font(size))
    pad = size * 0.4
    ground = (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad)
    draw.rounded_rectangle(ground, pad, fill=(10, 10, 12, 190))
    draw.multiline_text((size, size * 0.8), text, WHITE, font=_font(size))
    return np.asarray(image)

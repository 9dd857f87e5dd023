"""A contact sheet of lots: two of each of `FAMILIES`, each with its name."""

import contextlib
import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any

import jax
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.layouts import layout_config
from carpark_mj.rendering.recording import snapshot_of
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.video import font

FAMILIES = (
    *("square", "street", "street_parallel", "angled"),
    *("lot", "garage_row", "dead_end"),
)
LOTS = 2  # of each family
COLUMNS = 4
NUM_AGENTS, MOST_PARKED_CARS = 2, 24
GAP = 8  # pixels between pictures
PAPER, INK = (255, 255, 255), (30, 30, 30)
COLOURS = 256  # of the palette


def cell_size(width: int) -> tuple[int, int]:
    """Width and height of a picture on a sheet this wide [pixels]."""
    wide = max(2, (width + GAP) // COLUMNS - GAP)
    return wide, max(2, 2 * wide // 3)


def draw_lots(
    family: str, size: tuple[int, int], seed: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Draws a family's training lots as episodes start in them, half of the bays full.

    Yields a caption and a picture (height, width, 3) uint8 of each; the seed is that of
    the first lot, `size` the width and height of a picture [pixels].
    """
    full = min(layout_config(family).min_bays // 2, MOST_PARKED_CARS)
    env = ParkingEnv(EnvConfig(family, num_agents=NUM_AGENTS, num_parked_cars=full))
    reset = jax.jit(env.reset)
    for number in range(seed, seed + LOTS):
        state, _ = reset(evaluation_key(number))
        no_lines = np.zeros(NUM_AGENTS, bool)  # to the goals
        seen = dataclasses.replace(snapshot_of(state), active=no_lines)
        stage = Stage.of(env, state)
        with contextlib.closing(LotRenderer(stage, "overview", size)) as renderer:
            renderer.place(seen)
            yield f"{family}, seed {number}", renderer.draw(seen, "overview")


def contact_sheet(cells: Iterable[tuple[str, np.ndarray]]) -> Any:
    """Puts captioned pictures of one size in rows of `COLUMNS`; an image of PIL.

    A palette of colours keeps the file small.
    """
    from PIL import Image, ImageDraw

    cells = list(cells)
    height, width = cells[0][1].shape[:2]
    letters = max(10, round(height / 10))
    strip = round(1.5 * letters)
    rows = -(-len(cells) // COLUMNS)
    across, down = width + GAP, height + strip + GAP
    sheet = Image.new("RGB", (COLUMNS * across - GAP, rows * down - GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (caption, picture) in enumerate(cells):
        row, column = divmod(k, COLUMNS)
        x, y = column * across, row * down
        sheet.paste(Image.fromarray(picture), (x, y + strip))
        draw.text((x + 4, y + strip / 2), caption, INK, font=font(letters), anchor="lm")
    return sheet.quantize(COLOURS, dither=Image.Dither.NONE)

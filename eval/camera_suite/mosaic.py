"""Pictures of what cameras see: a row of cameras for depth, classes and colours."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax
import numpy as np
from PIL import Image

from camera_suite.lots import environment
from carpark_mj.cameras import (
    COLOURS,
    RIGS,
    BirdsEye,
    Heights,
    Seen,
    paint,
    see,
    see_from_above,
)
from carpark_mj.cameras.see import Channel
from carpark_mj.files import write_atomically

CHANNELS: tuple[Channel, ...] = ("depth", "seen", "colour")
GAP = 4  # pixels between pictures
ENLARGED = 3


def mosaic(layouts: Sequence[str], seed: int = 0) -> np.ndarray:
    """The cameras of one car in lots of some layouts, (rows, columns, 3) uint8."""
    sheets = []
    palette = (255 * np.array([COLOURS[kind] for kind in Seen])).astype(np.uint8)
    for layout in layouts:
        env = environment(layout)
        state = jax.jit(lambda key: env.reset(key)[0])(jax.random.key(seed))  # noqa: B023
        rig = dataclasses.replace(RIGS["surround"], shaded=True)
        heights = Heights.of(env.fleet)
        pictures = jax.jit(see, static_argnums=(0, 2))(rig, state, heights)
        own = jax.tree.map(lambda x: x[0], pictures)
        config = BirdsEye(3 * rig.height + 2 * GAP)
        above = jax.jit(see_from_above, static_argnums=0)(config, state)[0]
        painted = [np.asarray(paint(own, name)) for name in CHANNELS]
        rows = np.concatenate([_row(images) for images in painted])[:-GAP]
        sheets.append(np.concatenate([rows, _framed(palette[above])[:-GAP]], axis=1))
        sheets.append(np.full((2 * GAP, sheets[0].shape[1], 3), 255, np.uint8))
    return np.concatenate(sheets[:-1])


def write_mosaic(path: Path, layouts: Sequence[str], seed: int = 0) -> None:
    """Writes `mosaic` as a PNG, enlarged."""
    image = Image.fromarray(mosaic(layouts, seed))
    size = (image.width * ENLARGED, image.height * ENLARGED)
    image = image.resize(size, Image.Resampling.NEAREST)
    write_atomically(path, lambda temporary: image.save(temporary, format="PNG"))


def _row(images: np.ndarray) -> np.ndarray:
    return np.concatenate([_framed(image) for image in images], axis=1)


def _framed(image: np.ndarray) -> np.ndarray:
    return np.pad(image, ((0, GAP), (0, GAP), (0, 0)), constant_values=255)

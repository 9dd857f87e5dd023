"""Makes the clips of docs/gallery.md by the commands there, and the README's mosaic.

python eval/gallery.py                    # all
python eval/gallery.py street mosaic.gif  # clips whose path contains one of the words

A retrained policy drives differently: look at the clips and choose seeds.
"""

from carpark_mj.cli.process import enter
from carpark_mj.rendering.gl import choose_gl

if __name__ == "__main__":  # before the imports, which take seconds
    choose_gl()  # before MuJoCo is imported
    enter("gallery", "gallery:main")

import dataclasses
import os
import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from PIL import Image, ImageDraw, ImageOps, ImageSequence

from carpark_mj import programs
from carpark_mj.rendering.video import font, write_video
from shell import command

DOCS = Path(__file__).parents[1] / "docs"
PAGE = DOCS / "gallery.md"
# Clips of the mosaic and their captions, in rows of `COLUMNS`.
MOSAIC = {
    "parking.gif": "square: seven cars",
    "gallery/lot.gif": "anywhere: aisles",
    "dead_end.gif": "anywhere: a dead end",
    "gallery/valet.gif": "valet: behind a van",
    "gallery/street.gif": "anywhere: a street",
    "gallery/hope.gif": "hope: a tight bay",
}
COLUMNS = 3
WIDTH, HEIGHT, CAPTION = 320, 240, 40  # pixels, of a tile and what is below it
LETTERS = 27  # pixels: 11 where the mosaic is 390 wide, as on a phone
GRASS = "#5e7150"  # beyond the lots
SECONDS, FPS = 9, 5


@dataclasses.dataclass(frozen=True)
class GalleryConfig:
    """Settings of `python eval/gallery.py`.

    Attributes:
        clips: words in the paths of the clips to make; all if none.
    """

    clips: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="CLIP ...")
    ] = ()


def commands(page: str) -> dict[str, list[str]]:
    """Arguments of `carpark_mj render` by the clip they make."""
    lines = re.findall(r"^carpark_mj render (.*--out \S+\.gif)$", page, re.MULTILINE)
    return {line.split()[-1]: shlex.split(line) for line in lines}


def make(config: GalleryConfig) -> None:
    """Makes the requested clips in `docs/`."""
    os.chdir(DOCS)
    words = config.clips or ("",)
    for clip, arguments in commands(PAGE.read_text()).items():
        if any(word in clip for word in words):
            programs.run("render", arguments)
    if any(word in "mosaic.gif" for word in words):
        tiles = [_tiles(Path(clip), caption) for clip, caption in MOSAIC.items()]
        sheets = (_sheet(row) for row in zip(*tiles, strict=True))
        print(f"wrote mosaic.gif: {write_video(Path('mosaic.gif'), sheets, FPS)}")


def _tiles(clip: Path, caption: str) -> Iterator[Image.Image]:
    """Frames of a clip every `1 / FPS` seconds, with a caption below."""
    with Image.open(clip) as film:
        lasts = [frame.info["duration"] for frame in ImageSequence.Iterator(film)]
        ends = np.cumsum(lasts)
        for now in range(0, 1000 * SECONDS, 1000 // FPS):
            film.seek(min(int(np.searchsorted(ends, now, "right")), len(lasts) - 1))
            tile = Image.new("RGB", (WIDTH, HEIGHT + CAPTION), "white")
            shown = ImageOps.pad(film.convert("RGB"), (WIDTH, HEIGHT), color=GRASS)
            tile.paste(shown, (0, 0))
            place = (WIDTH / 2, HEIGHT + CAPTION / 2)
            draw = ImageDraw.Draw(tile)
            draw.text(place, caption, "black", font=font(LETTERS), anchor="mm")
            yield tile


def _sheet(tiles: Sequence[Image.Image]) -> np.ndarray:
    """One frame of the mosaic."""
    high = HEIGHT + CAPTION
    size = (COLUMNS * WIDTH, len(tiles) // COLUMNS * high)
    sheet = Image.new("RGB", size, "white")
    for number, tile in enumerate(tiles):
        row, column = divmod(number, COLUMNS)
        sheet.paste(tile, (column * WIDTH, row * high))
    return np.asarray(sheet)


main = command(GalleryConfig, make, __doc__)

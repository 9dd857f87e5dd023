"""Makes the README's mosaic of clips.

    cd docs && grep "^carpark_mj render" gallery.md | sh   # makes all clips
    python eval/gallery.py

A retrained policy drives differently: look at the clips and choose seeds.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageOps, ImageSequence

from carpark_mj.rendering.video import font, write_video

DOCS = Path(__file__).parents[1] / "docs"
# Clips and their captions, in rows of `COLUMNS`.
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


def sheets() -> Iterator[np.ndarray]:
    """Frames of the mosaic (height, width, 3)."""
    clips = [Image.open(DOCS / clip) for clip in MOSAIC]
    lasts = [[x.info["duration"] for x in ImageSequence.Iterator(c)] for c in clips]
    high, rows = HEIGHT + CAPTION, len(clips) // COLUMNS
    for now in range(0, 1000 * SECONDS, 1000 // FPS):
        sheet = Image.new("RGB", (COLUMNS * WIDTH, rows * high), "white")
        draw = ImageDraw.Draw(sheet)
        for k, (clip, caption) in enumerate(zip(clips, MOSAIC.values(), strict=True)):
            frame = int(np.searchsorted(np.cumsum(lasts[k]), now, "right"))
            clip.seek(min(frame, len(lasts[k]) - 1))
            x, y = k % COLUMNS * WIDTH, k // COLUMNS * high
            tile = ImageOps.pad(clip.convert("RGB"), (WIDTH, HEIGHT), color=GRASS)
            sheet.paste(tile, (x, y))
            middle = x + WIDTH / 2, y + HEIGHT + CAPTION / 2
            draw.text(middle, caption, "black", font=font(LETTERS), anchor="mm")
        yield np.asarray(sheet)


if __name__ == "__main__":
    print(f"wrote {write_video(DOCS / 'mosaic.gif', sheets(), FPS)} to docs/mosaic.gif")

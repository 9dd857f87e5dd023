"""The contact sheet: every family has its place, and cells are where they belong."""

import numpy as np

from carpark_mj.config import LAYOUTS
from carpark_mj.rendering import gallery
from carpark_mj.rendering.gallery import (
    COLUMNS,
    FAMILIES,
    GAP,
    LOTS,
    cell_size,
    contact_sheet,
    draw_lots,
)


def test_every_family_that_a_name_draws_is_in_the_gallery():
    others = {"square_compact", "mixture", "valet"}  # another square, mixes of others
    alone = (
        "slots",
        "clutter",
        "hope",
        "tpcap",
        "metadrive",
        "dragon_lake",
        "san_jose",
    )  # pictured on pages of their own
    drawn = {name for name in LAYOUTS if not name.startswith(alone)}
    assert set(FAMILIES) == drawn - others


def test_cells_stand_in_rows_with_their_pictures_whole():
    width, height = cell_size(400)
    assert COLUMNS * (width + GAP) - GAP <= 400
    colours = [(40 * k + 20, 90, 200 - 30 * k) for k in range(COLUMNS + 1)]
    cells = [
        (f"lot {k}", np.full((height, width, 3), colour, np.uint8))
        for k, colour in enumerate(colours)
    ]
    sheet = np.asarray(contact_sheet(cells).convert("RGB")).astype(int)
    strip = (sheet.shape[0] + GAP) // 2 - height - GAP
    for k, colour in enumerate(colours):
        row, column = divmod(k, COLUMNS)
        x, y = column * (width + GAP), row * (height + strip + GAP)
        picture = sheet[y + strip : y + strip + height, x : x + width]
        assert np.abs(picture - colour).max() < 12
        caption = sheet[y : y + strip, x : x + width]
        assert (caption.sum(axis=-1) < 300).sum() > 10  # ink


def test_two_lots_of_a_family_differ_and_show_cars(monkeypatch):
    monkeypatch.setattr(gallery, "NUM_AGENTS", 1)
    lots = list(draw_lots("garage_row", (96, 64), seed=0))
    assert [caption for caption, _ in lots] == [
        f"garage_row, seed {k}" for k in range(LOTS)
    ]
    first, second = (picture.astype(int) for _, picture in lots)
    assert first.shape == (64, 96, 3)
    assert np.abs(first - second).mean() > 3
    for picture in (first, second):  # the agent and its bay are blue, all else is not
        blue = picture[..., 2] - picture[..., :2].max(axis=-1) > 40
        assert 20 < blue.sum() < 2000

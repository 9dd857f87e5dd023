"""Clips of the gallery are as large and as long as their commands make them."""

import re
from pathlib import Path

import pytest
from PIL import Image, ImageSequence

import gallery
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.render import RenderConfig

ROOT = Path(__file__).parents[1]
CLIPS = gallery.commands(gallery.PAGE.read_text())


@pytest.mark.parametrize("clip", sorted(CLIPS))
def test_a_clip_is_as_large_and_long_as_its_command_makes_it(clip):
    config = read_flags(RenderConfig, CLIPS[clip])
    path = ROOT / "docs" / clip
    assert path.stat().st_size < 1e6
    with Image.open(path) as gif:
        lasts = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
        assert gif.size == (config.width, config.height)
    assert sum(lasts) == pytest.approx(1000 * config.seconds, abs=1000 / config.fps)
    assert min(lasts) == 1000 / config.fps


def test_the_pictures_of_the_gallery_are_those_its_commands_make():
    shown = re.findall(r"\]\((\S+\.gif)\)", (ROOT / "docs" / "gallery.md").read_text())
    assert sorted(shown) == sorted(CLIPS)
    assert set(gallery.MOSAIC) <= set(CLIPS)
    assert (ROOT / "docs" / "mosaic.gif").stat().st_size < 3e6

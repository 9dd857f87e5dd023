"""Rates, speeds, versions and pictures of the pages are those that were recorded."""

import re
import shlex

import pytest
from helpers.pages import ROOT, section
from helpers.programs import rows_of
from PIL import Image, ImageSequence

import carpark_mj
import gallery
from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.render import RenderConfig
from carpark_mj.policy import checkpoints
from carpark_mj.policy.runs import find_policy
from carpark_mj.pretrained import FOLDER, pretrained_names

DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text()
RESULTS = (DOCS / "results.md").read_text()


# Success rates: default and pretrained policies of the default task.
SUCCESS = [
    row
    for row in rows_of(DOCS / "results" / "success.csv")
    if row["group"] in ("default training", "presets")
]


def recorded(row, which):
    """A recorded rate, as pages write it."""
    low, high = row[f"{which}_low"], row[f"{which}_high"]
    return f"{row[which]} % ({low} … {high})" if low else f"{row[which]} %"


PRESETS_PART = section(RESULTS, "pretrained")


@pytest.mark.parametrize("name", pretrained_names())
def test_results_have_the_recorded_rates_of_a_policy(name):
    """Parked and crashed of every row of the page, of the shipped policy and card."""
    card = (FOLDER / f"{name}.md").read_text()
    found = [x for x in PRESETS_PART.splitlines() if x.startswith(f"| `{name}`")]
    shipped = [x for x in SUCCESS if x["policy"] == name and x["shipped"]]
    steps = checkpoints.read_header(find_policy(name))["env_steps"]
    assert {row["steps_M"] for row in shipped} == {f"{steps / 1e6:.0f}"}
    known = {(recorded(x, "parked"), recorded(x, "crashed")) for x in shipped}
    assert found
    for row in found:
        rates = tuple(cell.strip() for cell in row.split("|")[2:4])
        assert rates in known, row
        if name not in ("hope", "valet"):  # whose cards have other rows
            assert " | ".join(rates) in card, row


def test_the_page_has_the_recorded_default_training():
    part = RESULTS.split("\n## Success rate of the default training")[1]
    rows = [x for x in part.split("\n## ")[0].splitlines() if "core" in x and "|" in x]
    known = {
        (f"{x['steps_M']} M", recorded(x, "parked"), f"{x['timed_out']} %")
        for x in SUCCESS
    }
    assert rows
    for row in rows:
        cells = [cell.strip() for cell in row.split("|")]
        assert (cells[2], cells[3], cells[5]) in known, row


def test_the_ablations_of_the_page_are_recorded():
    """Every figure of a row of the page stands in the table of all trials."""
    known = (DOCS / "ablations.csv").read_text()
    rows = re.findall(
        r"^\| (?!setting|---).*\|$", (DOCS / "ablations.md").read_text(), re.M
    )
    assert len(rows) > 10
    for row in rows:
        for figure in re.findall(r"\d+\.\d+", row.split("|")[2]):
            assert figure in known, row


def test_rates_and_speeds_of_the_readme_are_those_of_the_results():
    known, said, name = {}, set(), ""
    for row in SUCCESS:
        known.setdefault(row["policy"], set()).update((row["parked"], row["crashed"]))
    for row in section(README, "policies table").splitlines()[2:]:
        rates = re.findall(r"[\d.]+(?= %| …)", re.sub(r"\(.*?\)", "", row))
        name = (re.findall(r"`(\w+)`", row.split("|")[1]) or [name])[0]
        assert rates, row
        assert {*rates} <= known[name], row
        said.add(name)
    assert said == {"cpu", *pretrained_names()}
    known = set(re.findall(r"\d+(?:,\d{3})+", section(RESULTS, "speeds")))
    said = set(re.findall(r"\d+(?:,\d{3})+", section(README, "speed table")))
    assert said
    assert said <= known


@pytest.mark.parametrize("page", [README, (DOCS / "index.md").read_text()])
def test_the_numbers_of_the_first_screen_are_those_of_the_tables(page):
    rows = page.split("squares).*\n\n")[1].splitlines()
    said = [cell.strip() for cell in rows[0].strip("|").split("|")]
    tables = ("policies table", "speed table", "accuracy table")
    for number, table in zip(said, tables, strict=True):
        assert number.removesuffix(" m") in section(README, table), number


PLACES = {
    "pyproject.toml": r'^version = "(.*)"',
    "CITATION.cff": r"^version: (.*)$",
    "docs/stability.md": r"version = \{(.*)\}",
}


@pytest.mark.parametrize("place", PLACES)
def test_the_version_is_the_same_everywhere(place):
    found = re.findall(PLACES[place], (ROOT / place).read_text(), re.MULTILINE)
    assert found == [carpark_mj.__version__]


CLIPS = {
    line.split()[-1]: shlex.split(line)
    for line in re.findall(
        r"^carpark_mj render (.*--out \S+\.gif)$",
        (DOCS / "gallery.md").read_text(),
        re.MULTILINE,
    )
}


@pytest.mark.parametrize("clip", sorted(CLIPS))
def test_a_clip_is_as_large_and_long_as_its_command_makes_it(clip):
    config = read_flags(RenderConfig, CLIPS[clip])
    path = DOCS / clip
    assert path.stat().st_size < 1e6
    with Image.open(path) as gif:
        lasts = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
        assert gif.size == (config.width, config.height)
    assert sum(lasts) == pytest.approx(1000 * config.seconds, abs=1000 / config.fps)
    assert min(lasts) == 1000 / config.fps


def test_the_pictures_of_the_gallery_are_those_its_commands_make():
    shown = re.findall(r"\]\((\S+\.gif)\)", (DOCS / "gallery.md").read_text())
    assert sorted(shown) == sorted(CLIPS)
    assert set(gallery.MOSAIC) <= set(CLIPS)
    assert (DOCS / "mosaic.gif").stat().st_size < 3e6

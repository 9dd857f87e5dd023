"""What a release says of itself: one version in all places."""

import re
import tomllib
from pathlib import Path

import pytest

import carpark_mj

ROOT = Path(__file__).parents[1]
PLACES = {
    "CITATION.cff": r"^version: (.*)$",
    "docs/stability.md": r"version = \{(.*)\}",
}


def test_the_package_has_the_version_of_its_distribution():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == carpark_mj.__version__


@pytest.mark.parametrize("place", PLACES)
def test_citations_have_the_version(place):
    found = re.findall(PLACES[place], (ROOT / place).read_text(), re.MULTILINE)
    assert found == [carpark_mj.__version__]

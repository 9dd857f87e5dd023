"""The example packages can be installed: their entry points name what is there."""

import tomllib

import pytest
from helpers.packages import PACKAGES

NAMES = sorted(path.name for path in PACKAGES.iterdir() if path.is_dir())


def test_there_is_one_for_each_of_the_eight_kinds_of_parts():
    assert len(NAMES) == 8


@pytest.mark.parametrize("name", NAMES)
def test_a_package_names_its_module_as_an_entry_point(name):
    project = tomllib.loads((PACKAGES / name / "pyproject.toml").read_text())
    points = project["project"]["entry-points"]["carpark_mj.extensions"]
    assert points == {name: name}
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["only-include"] == [f"{name}.py"]
    assert (PACKAGES / name / f"{name}.py").is_file()

"""The code and the tables of docs/junction.md."""

import re
from pathlib import Path

import pytest

from carpark_papers.cederle.junction import SCENARIOS

PAGE = (Path(__file__).parents[3] / "docs" / "junction.md").read_text()


def test_the_code_runs():
    first, pettingzoo = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    exec(first.replace("64", "2").replace("mjx", "path"), {})
    pytest.importorskip("pettingzoo")
    exec(pettingzoo, {})


def test_scenarios_have_their_ways_in_the_table():
    table = PAGE.split("## Scenarios")[1].split("## Actions")[0]
    rows = dict(re.findall(r"^\| `([\w-]+)` \|.*\| ([\d., ]+) \|$", table, re.M))
    assert rows == {
        name: ", ".join(f"{mission.length:.1f}" for mission in scenario.missions)
        for name, scenario in SCENARIOS.items()
    }

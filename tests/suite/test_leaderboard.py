"""Results that others can check, the leaderboard of them, and limits to accept them."""

import re
from pathlib import Path

import numpy as np
import pytest
from helpers import cases, leaderboard

from carpark_mj.cli.settings.tables import ReportConfig
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.suite import page as pages
from carpark_mj.suite.levels import find_level
from carpark_mj.suite.page import judge, parse_limit
from carpark_mj.suite.report import FOLDER, shown_levels
from carpark_mj.suite.results import Drives, key_of, write_run, write_submission

DOCS = Path(__file__).parents[2] / "docs"


def episodes(seeds=(0,)):
    """Every case of a level: the first ones crash, as many as the seed says and 2."""
    return [
        cases.episode(case, "tpcap", "crashed" if n < 2 + seed else "parked", seed=seed)
        for seed in seeds
        for n, case in enumerate(find_level("tpcap").numbers)
    ]


def test_rates_are_counted_from_what_was_written(tmp_path):
    rows = episodes((0, 1))
    [result] = leaderboard.read(write_submission(tmp_path, rows[::-1]))  # in any order
    rates = {"parked": 35 / 40, "crashed": 5 / 40, "timed_out": 0.0}
    assert result["rates"] == rates
    assert result["outcomes"][1].startswith("cccp")
    low, high = wilson_interval(17.5, 20)  # another seed is not another case
    shown = f"| 87.5 ({100 * low:.1f} … {100 * high:.1f}) | 12.5 |"
    assert shown in leaderboard.table([result])
    with pytest.raises(AssertionError):  # not all cases
        leaderboard.read(write_submission(tmp_path, rows[:-1]))


def test_the_leaderboard_is_that_of_its_files():
    page = (DOCS / "hard_cases.md").read_text()
    found = page.split("<!-- suite -->\n")[1].split("\n<!-- end of suite -->")[0]
    files = sorted((DOCS / "leaderboard").glob("*.json"))
    assert files
    table = leaderboard.table([r for path in files for r in leaderboard.read(path)])
    assert found == table, f"paste this:\n{table}"


def episode(case, parked=1.0, distance=0.05):
    end = "parked" if parked else "crashed"
    which = {"kind": "published", "rule": "precise", "made_with": "cpu, jax 1"}
    how = {"final_distance": distance, "path": 9.0 + case, "near_miss": 0.0}
    return cases.episode(case, "tpcap", end, length=9.0, **which, **how)


def many(count, parked):
    return [episode(case, float(case < parked)) for case in range(count)]


@pytest.mark.parametrize(
    ("limit", "rows", "verdict"),
    [
        # Wilson's intervals of 400 of 400, 390 and 300: above 0.990; 0.955 … 0.986;
        # 0.706 … 0.790.
        ("parked>=0.99", many(400, 400), "passed"),
        ("parked>=0.97", many(400, 390), "open"),
        ("parked>=0.99", many(400, 390), "failed"),
        ("crashed<=0.05", many(400, 390), "passed"),
        ("crashed<=0.2", many(400, 300), "failed"),
        ("hit_person<=0.01", many(400, 400), "open"),  # nobody is there
        ("final_distance<=0.05", many(4, 4), "passed"),
        ("final_distance<=0.05", [*many(4, 4), episode(5, 1.0, 0.06)], "failed"),
        ("final_distance<=0.05", [*many(4, 4), episode(5, 0.0, 9.0)], "passed"),
        ("path>=10.5", many(4, 4), "failed"),
        ("path>=9", many(4, 4), "passed"),
    ],
)
def test_a_limit_is_judged(limit, rows, verdict):
    assert judge(parse_limit(limit), rows)["verdict"] == verdict


def test_seeds_do_not_add_cases():
    once = many(20, 20)
    twice = [row | {"seed": seed} for row in once for seed in range(5)]
    limit = parse_limit("parked>=0.9")
    assert judge(limit, twice) == judge(limit, once)
    assert judge(limit, many(100, 100))["verdict"] == "passed"  # were they cases


@pytest.mark.parametrize(
    "text", ["parked", "parked>0.9", "perked>=0.9", "parked>=x", "parked>=1.5", ">=1"]
)
def test_other_limits_are_refused(text):
    with pytest.raises(ValueError, match=r".+"):
        parse_limit(text)


def test_the_page_stands_alone_and_has_the_films(tmp_path):
    rows = [episode(1), episode(2, 0.0, 3.0), episode(3)]
    shape = (1, 9, 1)
    drive = Drives(
        *(np.zeros(x, np.float32) for x in ((*shape, 2, 3), shape, shape)), None
    )
    write_run(tmp_path, rows, {key_of(rows[0]): drive})
    film = tmp_path / FOLDER / "x-tpcap-0-2.mp4"
    film.parent.mkdir()
    film.write_bytes(b"a film")
    page = tmp_path / "new" / "report.html"
    limits = ("crashed<=0.001", "final_distance<=0.1")
    judged = pages.main(ReportConfig((str(tmp_path),), limits, out=str(page)))
    assert [row["verdict"] for row in judged] == ["failed", "passed"]
    text = page.read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert sources
    assert all(source.startswith("data:") for source in sources)
    assert sum(source.startswith("data:video") for source in sources) == 1
    for shown in (find_level("tpcap").fingerprint, "jax 1", "precise", "failed"):
        assert shown in text


def test_levels_of_one_file_name_keep_their_paths():
    levels = ["scenario:a/child.yaml", "scenario:b/child.yaml", "scenario:b/door.yaml"]
    assert [*shown_levels(levels).values()] == [*levels[:2], "scenario:door.yaml"]

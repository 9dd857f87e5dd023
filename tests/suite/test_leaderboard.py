"""Results that others can check, the leaderboard of them, and limits to accept them."""

import json
import math
import re
from pathlib import Path

import pytest
from helpers import cases

from carpark_mj.cli.settings.tables import ReportConfig
from carpark_mj.config import find_rules
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.evaluation.tables import markdown
from carpark_mj.suite import page as pages
from carpark_mj.suite.levels import find_level, in_order
from carpark_mj.suite.page import judge, parse_limit
from carpark_mj.suite.report import FOLDER, shown_levels
from carpark_mj.suite.results import (
    FORMAT,
    VEHICLE,
    key_of,
    write_run,
    write_submission,
)

DOCS = Path(__file__).parents[2] / "docs"
SHARES = ("parked", "crashed", "timed_out")
MEANS = {"gear_changes": "gear changes", "path": "path [m]", "time_to_park": "time [s]"}


def read_entry(path):
    """The results of an entry, which must be about all held-out cases."""
    data = json.loads(path.read_text())
    assert data["format"] == FORMAT
    find_rules(data["rule"])
    alike = {"rule": data["rule"], "vehicle": data.get("vehicle", VEHICLE)}
    results = [alike | result for result in data["results"]]
    assert results
    for result in results:
        level, seeds = find_level(result["level"]), result["seeds"]
        assert result["held_out"] == level.fingerprint
        assert len({*seeds}) == len(seeds) > 0
        result["cases"] = count = len(level.numbers)
        if "rates" not in result:  # an older result, known from its table
            outcomes = result["outcomes"]
            assert [len(letters) for letters in outcomes] == [count] * len(seeds)
            letters = "".join(outcomes)
            assert {*letters} <= {*"pctd"}
            rates = {x: letters.count(x[0]) / len(letters) for x in SHARES}
            result["rates"] = rates
        assert math.isclose(sum(result["rates"].values()), 1.0, abs_tol=0.0015)
    return results


def shown_table(results):
    """The results in Markdown, by level and then by parked rate."""
    order, rows = in_order(result["level"] for result in results), []
    key = {level: number for number, level in enumerate(order)}
    for result in sorted(
        results, key=lambda x: (key[x["level"]], -x["rates"]["parked"])
    ):
        parked, crashed, timed_out = (result["rates"][name] for name in SHARES)
        low, high = wilson_interval(parked * result["cases"], result["cases"])
        other = "" if result["vehicle"] == VEHICLE else f", {result['vehicle']}"
        row = {
            "level": result["level"],
            "policy": f"`{result['policy']}`{' †' * ('outcomes' not in result)}",
            "rule": f"{result['rule']}{other}",
            "parked [%]": f"{100 * parked:.1f} ({100 * low:.1f} … {100 * high:.1f})",
            "crashed [%]": f"{100 * crashed:.1f}",
            "timed out [%]": f"{100 * timed_out:.1f}",
        }
        means = {title: result[name] for name, title in MEANS.items()}
        row |= {k: "–" if x is None else f"{x:.1f}" for k, x in means.items()}
        rows.append(row | {"seeds": str(len(result["seeds"]))})
    return markdown(rows, left=4)


def test_rates_are_counted_from_what_was_written(tmp_path):
    rows = [  # of every case: the first two crash, or three
        cases.episode(case, "tpcap", "crashed" if n < 2 + seed else "parked", seed=seed)
        for seed in (0, 1)
        for n, case in enumerate(find_level("tpcap").numbers)
    ]
    [result] = read_entry(write_submission(tmp_path, rows[::-1]))  # in any order
    rates = {"parked": 35 / 40, "crashed": 5 / 40, "timed_out": 0.0}
    assert result["rates"] == rates
    assert result["outcomes"][1].startswith("cccp")
    low, high = wilson_interval(17.5, 20)  # another seed is not another case
    shown = f"| 87.5 ({100 * low:.1f} … {100 * high:.1f}) | 12.5 |"
    assert shown in shown_table([result])
    with pytest.raises(AssertionError):  # not all cases
        read_entry(write_submission(tmp_path, rows[:-1]))


def test_the_leaderboard_is_that_of_its_files():
    page = (DOCS / "hard_cases.md").read_text()
    found = page.split("<!-- suite -->\n")[1].split("\n<!-- end of suite -->")[0]
    files = sorted((DOCS / "leaderboard").glob("*.json"))
    assert files
    table = shown_table([r for path in files for r in read_entry(path)])
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
        ("crashed<=0.2", many(400, 300), "failed"),
        ("hit_person<=0.01", many(400, 400), "open"),  # nobody is there
        ("final_distance<=0.05", many(4, 4), "passed"),
        ("final_distance<=0.05", [*many(4, 4), episode(5, 1.0, 0.06)], "failed"),
        ("final_distance<=0.05", [*many(4, 4), episode(5, 0.0, 9.0)], "passed"),
        ("path>=10.5", many(4, 4), "failed"),
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
    write_run(tmp_path, rows, {key_of(rows[0]): cases.drives(9)})
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

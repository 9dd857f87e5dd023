"""Limits are judged by intervals or by the worst repetition; the page stands alone."""

import re

import numpy as np
import pytest

from carpark_mj.cli.settings.tables import ReportConfig
from carpark_mj.suite.acceptance import judge, main, parse_limit
from carpark_mj.suite.levels import find_level
from carpark_mj.suite.report import FOLDER, shown_levels
from carpark_mj.suite.results import Drives, key_of, write_run


def episode(case, parked=1.0, distance=0.05):
    ends = {"parked": parked, "crashed": 1.0 - parked, "timed_out": 0.0}
    return {
        **{"policy": "x", "level": "tpcap", "kind": "published", "seed": 0},
        **{"case": case, "rule": "precise", "made_with": "cpu, jax 1"},
        "held_out": find_level("tpcap").fingerprint,
        **ends,
        **{"diverged": 0.0, "hit_agent": 0.0, "length": 9.0, "path": 9.0 + case},
        **{"gear_changes": 1.0, "time_to_park": 30.0, "final_distance": distance},
        **{"final_heading": 0.1, "ms / decision": 2.0, "near_miss": 0.0},
    }


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
    judged = main(ReportConfig((str(tmp_path),), limits, out=str(page)))
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

"""Files of results that others can check, and the table of the leaderboard's page."""

import json
from pathlib import Path

import pytest
from helpers.cases import episode

from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.suite.evaluation import SuiteConfig, main
from carpark_mj.suite.levels import find_level
from carpark_mj.suite.results import (
    check_submission,
    leaderboard,
    read_submission,
    write_submission,
)

DOCS = Path(__file__).parents[2] / "docs"


def episodes(seeds=(0,)):
    """Every case of a level: the first ones crash, as many as the seed says and 2."""
    return [
        episode(case, "tpcap", "crashed" if n < 2 + seed else "parked", seed=seed)
        for seed in seeds
        for n, case in enumerate(find_level("tpcap").numbers)
    ]


def test_rates_are_counted_from_what_was_written(tmp_path, capsys):
    rows = episodes((0, 1))
    path = write_submission(tmp_path, rows[::-1])  # in any order
    [result] = check_submission(path)
    assert result.shares == {"parked": 35 / 40, "crashed": 5 / 40, "timed_out": 0.0}
    assert result.cases == 20
    assert result.outcomes[1].startswith("cccp")
    assert main(SuiteConfig(check=str(path))) == []
    low, high = wilson_interval(17.5, 20)  # another seed is not another case
    shown = f"| 87.5 ({100 * low:.1f} … {100 * high:.1f}) | 12.5 |"
    assert shown in capsys.readouterr().out


def test_the_leaderboard_takes_every_case_and_outcomes_only(tmp_path):
    path = write_submission(tmp_path, episodes()[:-1])
    assert read_submission(path)[0].cases == 19
    with pytest.raises(
        ValueError, match="x has outcomes of 19 of the 20 cases of level tpcap"
    ):
        check_submission(path)
    data = json.loads(path.read_text())
    del data["results"][0]["outcomes"]
    rates = {"parked": 0.9, "crashed": 0.1, "timed_out": 0.0}
    data["results"][0]["rates"] = rates
    path.write_text(json.dumps(data))
    assert read_submission(path)[0].shares == rates
    with pytest.raises(ValueError, match="x has outcomes of 0 of the 20"):
        check_submission(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"level": "hard"}, "level must be one of .*, not 'hard'"),
        ({"held_out": "0"}, "held_out must be '.*', not '0'"),
        ({"seeds": [0, 0]}, r"seeds must be different whole numbers, not \(0, 0\)"),
        ({"path": -1.0}, "path must be at least 0, not -1"),
        ({"rates": {}}, "outcomes or rates must be given, not both"),
        ({"outcomes": []}, "outcomes must be a string"),
        ({"outcomes": ["px"]}, "letters p, c, t, d"),
        ({"outcomes": ["p" * 21]}, "1 to 20 letters"),
        ({"seeds": [0, 1], "outcomes": ["pp", "p"]}, "all of the same length"),
    ],
)
def test_results_that_contradict_themselves_are_refused(changes, message, tmp_path):
    path = write_submission(tmp_path, episodes())
    data = json.loads(path.read_text())
    data["results"][0] |= changes
    path.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=f"suite.json, result 1.*{message}"):
        read_submission(path)


def test_a_check_drives_nothing():
    with pytest.raises(ValueError, match=r"policies .* no effect with --check"):
        SuiteConfig(policies=("hope",), check="suite.json")


def test_the_leaderboard_is_that_of_its_files():
    page = (DOCS / "hard_cases.md").read_text()
    found = page.split("<!-- suite -->\n")[1].split("\n<!-- end of suite -->")[0]
    files = sorted((DOCS / "leaderboard").glob("*.json"))
    assert files
    table = leaderboard([r for path in files for r in read_submission(path)])
    assert found == table, f"paste this:\n{table}"

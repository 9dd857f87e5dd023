"""Entries of the leaderboard, `docs/leaderboard/*.json`, checked and as a table."""

import json
import math

from carpark_mj.config import find_rules
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.evaluation.tables import markdown
from carpark_mj.suite.levels import find_level, in_order
from carpark_mj.suite.results import FORMAT, VEHICLE

SHARES = ("parked", "crashed", "timed_out")
MEANS = {"gear_changes": "gear changes", "path": "path [m]", "time_to_park": "time [s]"}


def read(path):
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


def table(results):
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

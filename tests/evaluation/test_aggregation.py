"""Episodes add up exactly, under the names and in the units of the catalogue."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.pages import cells, section

from carpark_mj.evaluation import catalogue
from carpark_mj.evaluation.aggregation import (
    HITS,
    complete_row,
    contacts,
    effective_episodes,
    pool,
    summarize,
    wilson_interval,
)
from carpark_mj.evaluation.catalogue import GOALS, POOLS, metrics
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.mdp.metrics import CONTEXTS, METRICS
from carpark_mj.obstacles import hit_kinds
from carpark_mj.types import ENDINGS

BY_NAME = {metric.name: metric for metric in metrics()}


def episode(length=10.0, **numbers):
    row = {"parked": 0.0, "crashed": 0.0, "length": length}
    return complete_row(row | numbers, 0.2)


def test_episodes_add_up_to_the_same_bits_whatever_their_order(everything):
    rows = everything.episodes
    for order in (rows[::-1], sorted(rows, key=lambda row: row["length"])):
        assert json.dumps(summarize(order)) == json.dumps(summarize(rows))


def test_steps_are_pooled_and_shares_of_episodes_averaged():
    rows = [
        episode(10, speed_sum=10.0, goal_steps=10.0, towards_goal_steps=10.0),
        episode(30, speed_sum=90.0, goal_steps=30.0, towards_goal_steps=0.0),
        episode(60, speed_sum=0.0, goal_steps=0.0, towards_goal_steps=0.0),
    ]
    assert [row["speed"] for row in rows] == [1.0, 3.0, 0.0]
    assert pool(BY_NAME["speed"], rows) == 1.0  # (10 + 90 + 0) / 100
    assert math.isnan(rows[2]["towards_goal"])
    assert pool(BY_NAME["towards_goal"], rows) == 0.5  # of two episodes
    assert math.isnan(pool(BY_NAME["towards_goal"], rows[2:]))
    assert math.isnan(pool(BY_NAME["speed"], []))


def test_what_follows_from_the_numbers_of_an_episode():
    rows = [episode(length, crashed=1.0) for length in np.arange(1.0, 5.0)]
    # The study counts crashes at a step count below 2.
    assert [row["crashed_at_start"] for row in rows] == [1.0, 0.0, 0.0, 0.0]
    assert episode(1.0, parked=1.0)["crashed_at_start"] == 0.0
    # The time to park is of parked episodes only.
    rows = [episode(10, parked=1.0), episode(20, parked=1.0), episode(50)]
    assert pool(BY_NAME["time_to_park"], rows) == pytest.approx(3.0)
    assert math.isnan(pool(BY_NAME["time_to_park"], rows[2:]))
    assert math.isnan(rows[2]["time_to_park"])
    # The least clearance is to whatever was nearest.
    near = {"agent": 3, "parked_car": 1, "wall": 2}
    near = {f"min_clearance_{kind}": gap for kind, gap in near.items()}
    assert episode(**near)["min_clearance"] == 1
    # Returns by term are means over episodes.
    rows = [episode(return_park=park, return_time=-1.0) for park in (4.0, 0.0)]
    assert summarize(rows)["mean_returns"] == {"park": 2.0, "time": -1.0}


def test_extremes_have_a_median_a_quantile_and_the_worst():
    rows = [episode(peak_jerk=float(k), min_clearance=float(k)) for k in range(100)]
    assert pool(BY_NAME["peak_jerk"], rows) == {"median": 49, "p95": 94, "max": 99}
    assert pool(BY_NAME["min_clearance"], rows) == {"median": 49, "p5": 4, "min": 0}


def outcome_row(outcome, hit="", **numbers):
    """An episode with its outcome and the numbers given."""
    flags = {name: float(name in (outcome, hit)) for name in ENDINGS + HITS}
    return episode(**(flags | numbers))


def test_a_summary_is_what_a_hand_count_gives():
    rows = [
        outcome_row("parked", length=20.0, path=6.0, final_heading=0.1),
        outcome_row("parked", length=10.0, path=2.0, final_heading=0.3),
        outcome_row("crashed", "hit_wall", path=9.0, final_heading=1.0),
        outcome_row("timed_out", length=200.0, path=9.0, final_heading=1.0),
    ]
    summary = summarize(rows)
    assert summary["episodes"] == 4
    low, high = wilson_interval(2, 4)
    assert summary["parked"] == {"rate": 0.5, "low": low, "high": high, "count": 2}
    assert summary["hit_wall"]["count"] == 1
    assert summary["length"] == (20 + 10 + 10 + 200) / 4
    # Of parked episodes, in the units of the catalogue: seconds, metres, radians.
    assert summary["time_to_park"] == pytest.approx(0.2 * 15)
    assert summary["path"] == 4.0
    assert summary["final_heading"] == pytest.approx(0.2)


def test_no_episodes_have_rates_that_could_be_anything():
    summary = summarize([])
    assert summary["episodes"] == 0
    assert set(summary) == {"episodes", "mean_returns", *ENDINGS, *HITS}
    for name in ENDINGS + HITS:
        rate = summary[name]
        assert math.isnan(rate.pop("rate"))
        assert rate == {"low": 0.0, "high": 1.0, "count": 0.0}


def test_the_wrong_way_share_weighs_by_the_way_driven():
    assert "wrong_way_share" not in summarize([episode(path=30.0)])
    rows = [episode(path=p, wrong_way=w) for p, w in ((30.0, 3.0), (10.0, 5.0))]
    assert [row["wrong_way_share"] for row in rows] == [0.1, 0.5]
    assert summarize(rows)["wrong_way_share"] == pytest.approx(8 / 40)
    still = [episode(path=0.0, wrong_way=0.0)]
    assert math.isnan(summarize(still)["wrong_way_share"])


def test_wilson_intervals_match_published_values():
    # 8 of 10 (Agresti & Coull 1998 and any calculator): 0.490, 0.943.
    np.testing.assert_allclose(wilson_interval(8, 10), (0.4902, 0.9433), atol=1e-4)
    low, high = wilson_interval(0, 20)
    assert low == 0.0
    assert high == pytest.approx(0.1611, abs=1e-4)  # z^2 / (n + z^2)
    for trials in (20, 128, 4000):  # not 1 less rounding
        assert wilson_interval(trials, trials)[1] == 1.0
        assert wilson_interval(0, trials)[0] == 0.0
    assert wilson_interval(0, 0) == (0.0, 1.0)


def in_lots(outcomes, **stratum):
    """Episodes with `parked` as given for each lot."""
    either = [episode(parked=parked, **stratum) for parked in (0.0, 1.0)]
    return [
        either[int(parked)] | {"lot": float(lot)}
        for lot, episodes in enumerate(outcomes)
        for parked in episodes
    ]


def test_episodes_that_repeat_tell_nothing_new():
    rng = np.random.default_rng(1)
    lots = rng.uniform(size=(40, 5)) < rng.uniform(0.2, 1, size=(40, 1))
    one = effective_episodes("parked", in_lots(lots))
    assert 50 < one < 180
    five = effective_episodes("parked", in_lots(np.tile(lots, 5)))
    assert five == pytest.approx(one, rel=0.01)  # 199 / 200 and 999 / 1000
    alike = in_lots(np.repeat(lots[:, :1], 9, axis=1))
    assert effective_episodes("parked", alike) == pytest.approx(39 * 360 / 359)


def test_two_lots_of_three_episodes_by_hand():
    # Variance of the sum of six independent ones: 6 / 5 times 6 / 4, 1.8. Of the lots:
    # deviations 2 - 1.5 and 1 - 1.5, 2 (0.25 + 0.25) = 1, but none counts for more.
    assert effective_episodes("parked", in_lots([[1, 1, 0], [1, 0, 0]])) == 6
    # Deviations of 1.5: 2 (2.25 + 2.25) = 9, five times 1.8.
    apart = in_lots([[1, 1, 1], [0, 0, 0]])
    assert effective_episodes("parked", apart) == pytest.approx(6 / 5)
    # One lot in a family says nothing about how its lots vary: 4.5.
    families = [row | {"family": "ab"[int(row["lot"])]} for row in apart]
    assert effective_episodes("parked", families) == pytest.approx(6 / 2.5)


@pytest.mark.parametrize("outcomes", [[[1, 1]] * 3, [[0, 0]] * 3, [[1, 0, 1, 0]]])
def test_episodes_count_in_full_where_lots_do_not_differ(outcomes):
    rows = in_lots(outcomes)
    assert effective_episodes("parked", rows) == len(rows)
    without = [{"parked": row["parked"], "crashed": math.nan} for row in rows]
    assert effective_episodes("parked", without) == pytest.approx(len(rows))
    assert effective_episodes("crashed", without) == 0


def test_intervals_of_lots_that_differ_cover_the_rate():
    rng = np.random.default_rng(2)
    covered, as_if_independent, trials = 0, 0, 300
    for _ in range(trials):
        rates = rng.beta(18, 2, size=60)  # 0.9 on average
        lots = rng.uniform(size=(60, 30)) < rates[:, None]
        rate = pool(BY_NAME["parked"], in_lots(lots))
        covered += rate["low"] <= 0.9 <= rate["high"]
        low, high = wilson_interval(rate["count"], 1800)
        as_if_independent += low <= 0.9 <= high
    assert 0.92 < covered / trials < 0.98
    assert as_if_independent / trials < 0.85


def drive(path=9.0, hit=0.0, speed=0.0):
    return {"path": path, "hit_person": hit, "peak_contact_speed": speed}


def test_every_contact_of_cars_that_drove_is_in_one_class():
    speeds = (0.0, 0.4, 0.5, 1.0, 1.7, 2.4)
    rows = [drive(hit=1.0, speed=speed) for speed in speeds]
    rows += [drive()] * 94 + [drive(path=0.05)] * 50
    found = contacts(rows)
    assert found is not None
    assert found.pop("episodes") == 100
    counts = {name: rate["count"] for name, rate in found.items()}
    assert counts == {"any": 6, "0..0.5": 2, "0.5..1": 1, "1..2": 2, "2..": 1}
    rate = found["any"]
    assert (rate["low"], rate["high"]) == pytest.approx(wilson_interval(6, 100))


def test_without_a_contact_there_is_an_upper_bound():
    found = contacts([drive()] * 40_000)
    assert found is not None
    assert found["1..2"]["low"] == 0.0
    assert found["1..2"]["high"] == pytest.approx(1e-4, rel=0.05)
    assert contacts([]) is None
    assert contacts([{"path": 1.0}]) is None


PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_the_page_of_metrics_has_the_aggregations():
    expected = "\n".join(f"- *{name}*: {text}" for name, text in POOLS.items())
    assert section(PAGE.read_text(), "pools") == expected, f"paste this:\n{expected}"


@pytest.mark.parametrize("part", ["outcome", "driving", "safety", "goals"])
def test_the_page_of_metrics_has_those_of_the_catalogue(part):
    page = PAGE.read_text()
    stands_for = {"KIND": [row[0] for row in cells(page, "kinds")], "CONTEXT": CONTEXTS}
    expected = {m.name: m for m in getattr(catalogue, part.upper())}
    found = []
    for name, unit, meaning, how in cells(page, part):
        word = name.rpartition("_")[2]
        names = [name.replace(word, x) for x in stands_for.get(word, [word])]
        found += [(one, unit, how) for one in names]
        if names == [name]:
            assert meaning == expected[name].meaning.strip("`"), name
    assert sorted(found) == sorted((m.name, m.unit, m.pool) for m in expected.values())


def test_every_number_of_an_episode_is_in_the_catalogue(everything):
    assert len(BY_NAME) == len([*metrics()])
    known = set(BY_NAME) | {"lot", "agent", "episode", "agents_present", "family"}
    known |= {"vehicle"}
    known |= {name for metric in metrics() for name in metric.ratio or ()}
    # No lanes and nobody else in this lot, and the goals are fixed.
    others = {kind.label for kind in ObstacleKind} - {k.label for k in hit_kinds(())}
    absent = {"wrong_way", "wrong_way_share"} | {metric.name for metric in GOALS}
    absent |= {n for n in BY_NAME if n.endswith(tuple(f"_{kind}" for kind in others))}
    absent |= {n for n in METRICS if METRICS[n].kind is not None}
    absent |= {name for metric in GOALS for name in metric.ratio or ()} - {"length"}
    for row in everything.episodes:
        assert known - set(row) == absent
        returns = {name for name in row if name.startswith("return_")}
        assert set(row) - returns <= known
    others = {"episodes", "mean_returns"}
    assert everything.summary.keys() - others == set(BY_NAME) - absent
    assert {metric.pool for metric in metrics()} == set(POOLS)


def test_a_clearance_is_zero_to_what_was_hit_only(everything):
    rows = everything.episodes
    for kind in (kind.label for kind in hit_kinds(())):
        zero = [row[f"min_clearance_{kind}"] == 0.0 for row in rows]
        assert zero == [row[f"hit_{kind}"] == 1.0 for row in rows]
        assert any(zero)
    assert sum(row["crashed"] for row in rows) < len(rows)


def test_tallies_start_anew_with_every_episode(everything):
    rows = everything.episodes
    assert len({row["episode"] for row in rows}) == 10
    for row in rows:
        assert row["goal_steps"] == row["nearest_car_steps"] == row["length"]
        # Always 0.8 of 2.5 m/s, 0.5 m a step.
        assert row["speed"] == pytest.approx(2.0)
        assert row["path"] == pytest.approx(0.4 * row["length"], rel=1e-4)


def test_measuring_leaves_the_episodes_as_they_are(everything, plain):
    for row, more in zip(plain.episodes, everything.episodes, strict=True):
        kept = {name: more[name] for name in row}
        assert json.dumps(kept) == json.dumps(row)  # NaN like NaN
    assert plain.summary["length"] == everything.summary["length"]
    assert "speed" not in plain.summary

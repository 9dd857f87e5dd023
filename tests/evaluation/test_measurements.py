"""What is measured of whole episodes of cars that slide."""

import json

import pytest

from carpark_mj.evaluation.catalogue import GOALS, POOLS, metrics
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.mdp.metrics import METRICS
from carpark_mj.obstacles import hit_kinds

BY_NAME = {metric.name: metric for metric in metrics()}


def test_every_number_of_an_episode_is_in_the_catalogue(everything):
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


def test_a_crash_is_a_clearance_of_zero_to_what_was_hit_and_nothing_else_is(everything):
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

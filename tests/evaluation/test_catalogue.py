"""The catalogue of metrics is complete, and measured values are in it."""

import json
from pathlib import Path

import pytest
from helpers.pages import cells, section

from carpark_mj.evaluation import catalogue
from carpark_mj.evaluation.catalogue import GOALS, POOLS, metrics
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.mdp.metrics import CONTEXTS, COUNTS, METRICS
from carpark_mj.obstacles import hit_kinds

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def test_names_are_unique_and_every_pool_is_explained():
    names = [metric.name for metric in metrics()]
    assert len(set(names)) == len(names)
    assert {metric.pool for metric in metrics()} == set(POOLS)


def test_every_context_of_giving_way_has_a_conformity_of_its_own():
    conformities = [m for m in GOALS if m.name.startswith("conformity_")]
    assert [m.name.removeprefix("conformity_") for m in conformities] == [*CONTEXTS]
    for metric, name in zip(conformities, CONTEXTS, strict=True):
        assert metric.ratio == (f"gave_way_{name}", f"met_{name}")
    assert len({metric.meaning for metric in conformities}) == len(CONTEXTS)


def test_every_count_of_goals_is_a_metric_or_a_part_of_one():
    used = {metric.name for metric in GOALS}
    used |= {name for metric in GOALS for name in metric.ratio or ()}
    assert set(COUNTS) <= used


def test_the_page_of_metrics_has_the_aggregations():
    expected = "\n".join(f"- *{name}*: {text}" for name, text in POOLS.items())
    assert section(PAGE.read_text(), "pools") == expected, f"paste this:\n{expected}"


@pytest.mark.parametrize("part", ["outcome", "driving", "safety", "goals"])
def test_the_page_of_metrics_has_those_of_the_catalogue(part):
    page = PAGE.read_text()
    stands_for = {"KIND": [row[0] for row in cells(page, "kinds")], "CONTEXT": CONTEXTS}
    expected = {m.name: m for m in getattr(catalogue, part.upper())}
    found = []
    for name, unit, meaning, pool in cells(page, part):
        word = name.rpartition("_")[2]
        names = [name.replace(word, x) for x in stands_for.get(word, [word])]
        found += [(one, unit, pool) for one in names]
        if names == [name]:
            assert meaning == expected[name].meaning.strip("`"), name
    assert sorted(found) == sorted((m.name, m.unit, m.pool) for m in expected.values())


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

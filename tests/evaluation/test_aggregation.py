"""Episodes add up exactly, and every metric is defined in the catalogue."""

import csv
import itertools
import json
import math
import re
from pathlib import Path

import jax
import numpy as np
import pytest
from helpers.scenes import SlidePhysics

from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    MetricsConfig,
    ObservationConfig,
)
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation import catalogue
from carpark_mj.evaluation.aggregation import complete_row, pool, pool_all
from carpark_mj.evaluation.catalogue import GOALS, METRICS, POOLS, START_STEPS
from carpark_mj.evaluation.rollout import evaluate
from carpark_mj.mdp.metrics.tallies import KINDS

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"
BY_NAME = {metric.name: metric for metric in METRICS}


def episode(length=10.0, **numbers):
    row = {"parked": 0.0, "crashed": 0.0, "length": length}
    return complete_row(row | numbers, 0.2)


def random_episodes(count):
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(count):
        length = float(rng.integers(1, 200))
        steps = float(rng.integers(0, 3) * length // 2)  # a third without another car
        rows.append(
            episode(
                length,
                parked=float(rng.uniform() < 0.5),
                speed_sum=float(np.float32(rng.uniform(0, 3) * length)),
                nearest_car_sum=float(np.float32(rng.uniform(3, 20) * steps)),
                nearest_car_steps=steps,
                goal_steps=steps,
                towards_goal_steps=float(rng.integers(0, steps + 1)),
                peak_jerk=float(rng.uniform(0, 9)),
                final_speed=float(rng.uniform()),
            )
        )
    return rows


def test_episodes_add_up_to_the_same_bits_whatever_their_order():
    rows = random_episodes(500)
    together = pool_all(rows)
    assert len(together) > 8
    assert pool_all(rows[::-1]) == together
    assert pool_all(sorted(rows, key=lambda row: row["length"])) == together


def test_parts_of_two_batchings_add_up_to_the_whole():
    rows = random_episodes(500)
    whole = pool(BY_NAME["nearest_car"], rows)
    means = []
    for cuts in ((0, 7, 500), (0, 100, 130, 450, 500)):
        parts = [rows[a:b] for a, b in itertools.pairwise(cuts)]
        above = [sum(row["nearest_car_sum"] for row in part) for part in parts]
        below = [sum(row["nearest_car_steps"] for row in part) for part in parts]
        assert sum(above) / sum(below) == pytest.approx(whole, rel=1e-12)
        means.append(np.mean([pool(BY_NAME["nearest_car"], part) for part in parts]))
    assert np.abs(np.array(means) - whole).min() > 1e-3  # what pooling must not be


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


def test_crashes_at_the_start_are_those_of_the_first_steps():
    lengths = np.arange(1.0, 5.0)
    rows = [episode(length, crashed=1.0) for length in lengths]
    found = [row["crashed_at_start"] for row in rows]
    assert found == [1.0, 1.0, 0.0, 0.0]
    assert START_STEPS == 2
    assert episode(1.0, parked=1.0)["crashed_at_start"] == 0.0


def test_extremes_have_a_median_a_quantile_and_the_worst():
    rows = [episode(peak_jerk=float(k), min_clearance=float(k)) for k in range(100)]
    assert pool(BY_NAME["peak_jerk"], rows) == {"median": 49, "p95": 94, "max": 99}
    assert pool(BY_NAME["min_clearance"], rows) == {"median": 49, "p5": 4, "min": 0}


def test_time_to_park_is_of_parked_episodes_only():
    rows = [episode(10, parked=1.0), episode(20, parked=1.0), episode(50)]
    assert pool(BY_NAME["time_to_park"], rows) == pytest.approx(3.0)
    assert math.isnan(pool(BY_NAME["time_to_park"], rows[2:]))
    assert math.isnan(rows[2]["time_to_park"])


def test_the_least_clearance_is_to_whatever_was_nearest():
    near = {"agent": 3, "parked_car": 1, "wall": 2}
    near = {f"min_clearance_{kind}": gap for kind, gap in near.items()}
    assert episode(**near)["min_clearance"] == 1


def onwards(observation, key):
    """Drives ahead, swerving at random."""
    action = jax.random.uniform(key, (*observation.shape[:-1], 2), minval=-1.0)
    return action.at[..., 1].set(0.8), {}


def evaluation(config):
    env = ParkingEnv(
        EnvConfig(
            num_agents=3,
            num_parked_cars=10,
            episode=EpisodeConfig(max_steps=20),
            observation=ObservationConfig(0, 0, rings=()),
            metrics=config,
        ),
        SlidePhysics(),
    )
    return evaluate(env, onwards, num_episodes=90, seed=0, num_lots=3)


@pytest.fixture(scope="module")
def everything():
    return evaluation(MetricsConfig(driving=True, safety=True))


def test_every_number_of_an_episode_is_in_the_catalogue(everything):
    known = set(BY_NAME) | {"lot", "agent", "episode", "family"}
    known |= {name for metric in METRICS for name in metric.ratio or ()}
    # No lanes in this lot, and the goals are fixed.
    absent = {"wrong_way"} | {metric.name for metric in GOALS}
    absent |= {name for metric in GOALS for name in metric.ratio or ()} - {"length"}
    for row in everything.episodes:
        assert known - set(row) == absent
        returns = {name for name in row if name.startswith("return_")}
        assert set(row) - returns <= known
    assert everything.summary["metrics"].keys() == set(BY_NAME) - absent
    assert {metric.pool for metric in METRICS} == set(POOLS)


def test_what_is_written_adds_up_to_what_is_written(everything, tmp_path, capsys):
    from carpark_mj.evaluation import report as command

    table, data = command.write_evaluation(tmp_path, everything, {})
    with table.open(newline="") as file:
        rows = [
            {name: float(x) for name, x in row.items() if name != "family"}
            for row in csv.DictReader(file)
        ]
    stored = json.loads(data.read_text())["summary"]["metrics"]
    assert json.dumps(pool_all(rows)) == json.dumps(stored)  # NaN like NaN
    command.print_metrics(everything.summary["metrics"])
    printed = capsys.readouterr().out
    for name in ("nearest car", "min collision time agent", "worst 5 %"):
        assert name in printed


def test_a_crash_is_a_clearance_of_zero_to_what_was_hit_and_nothing_else_is(
    everything,
):
    rows = everything.episodes
    for kind in KINDS:
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


def test_measuring_leaves_the_episodes_as_they_are(everything):
    plain = evaluation(MetricsConfig())
    for row, more in zip(plain.episodes, everything.episodes, strict=True):
        kept = {name: more[name] for name in row}
        assert json.dumps(kept) == json.dumps(row)  # NaN like NaN
    metrics = plain.summary["metrics"]
    assert metrics["length"] == everything.summary["metrics"]["length"]
    assert "speed" not in metrics


@pytest.mark.parametrize("part", ["pools", "outcome", "driving", "safety", "goals"])
def test_the_page_of_metrics_is_made_from_the_catalogue(part):
    if part == "pools":
        expected = "\n".join(f"- *{name}*: {text}" for name, text in POOLS.items())
    else:
        expected = catalogue.markdown_table(getattr(catalogue, part.upper()))
    pattern = rf"<!-- {part} -->\n(.*?)\n?<!-- end of {part} -->"
    found = re.search(pattern, PAGE.read_text(), re.DOTALL)
    assert found, f"paste this between the markers:\n{expected}"
    assert found[1].strip() == expected, f"paste this:\n{expected}"

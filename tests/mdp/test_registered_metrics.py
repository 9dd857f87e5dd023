"""Metrics that other code registers."""

import itertools

import numpy as np
import pytest
from helpers.scenes import cars, lot
from helpers.transitions import no_terms, transition

from carpark_mj.config import METRICS, EnvConfig, Metric, MetricsConfig, register_metric
from carpark_mj.evaluation.aggregation import complete_row, summarize
from carpark_mj.evaluation.catalogue import metrics
from carpark_mj.evaluation.report import print_metrics
from carpark_mj.mdp.metrics import episode_metrics, init_stats, update_stats

PLAN = lot([(0.0, 0.0, 0.0)])
SPEEDS = [(0.0, 0.0), (3.0, -1.0), (1.0, -2.0)]
POOLS = {"count": "mean", "pace": "steps", "min_pace": "least", "peak_pace": "most"}


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Metrics of the signed speed, one for every way to add up."""
    monkeypatch.setattr(METRICS, "_parts", dict(METRICS._parts))
    for name, pool in POOLS.items():
        register_metric(
            Metric(name, "m/s", "speed", pool, value=lambda c, t: t.after.motion.speed)
        )


def episode(extra):
    """Metrics of two cars after two steps."""
    config = EnvConfig(num_agents=2, metrics=MetricsConfig(extra=extra))
    stats = init_stats(config, PLAN)
    states = [cars([(0.0, 0.0, 0.0)] * 2, speed=list(speed)) for speed in SPEEDS]
    for before, after in itertools.pairwise(states):
        happened = transition(config, PLAN, before, after, {"stats": stats})
        stats = update_stats(config, happened, no_terms(config))
    found = episode_metrics(happened, stats)
    return {name: np.asarray(value).tolist() for name, value in found.items()}


def test_metrics_are_pooled_over_an_episode():
    found = episode(tuple(POOLS))
    assert found["count"] == found["pace_sum"] == [4.0, -3.0]
    assert found["min_pace"] == [1.0, -2.0]
    assert found["peak_pace"] == [3.0, -1.0]  # not 0, where it began


def test_what_is_not_asked_for_is_not_measured():
    assert "count" not in episode(())
    assert {"count", "pace_sum"} & {*episode(("pace",))} == {"pace_sum"}
    assert {*POOLS} <= {*MetricsConfig.everything().extra}


def test_evaluations_have_it_in_their_rows_summaries_and_tables(capsys):
    found = episode(tuple(POOLS))
    rows = [
        complete_row({name: value[k] for name, value in found.items()}, 0.2)
        for k in range(2)
    ]
    assert [row["pace"] for row in rows] == [2.0, -1.5]
    summary = summarize(rows)
    assert summary["pace"] == pytest.approx(0.25)
    assert summary["count"] == pytest.approx(0.5)
    assert summary["min_pace"]["min"] == -2.0
    assert summary["peak_pace"]["max"] == 3.0
    assert {*POOLS} <= {metric.name for metric in metrics()}
    print_metrics(summary)
    assert "peak pace" in capsys.readouterr().out

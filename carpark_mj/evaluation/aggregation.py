"""Metrics of many episodes together, exact whatever batches they came in."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from carpark_mj.evaluation.catalogue import METRICS, START_STEPS, Metric
from carpark_mj.mdp.metrics.tallies import KINDS


def complete_row(row: dict[str, float], ctrl_dt: float) -> dict[str, float]:
    """An episode with what follows from its own numbers added, in catalogue order.

    Ratios without a denominator are NaN; nothing is added whose parts are missing.

    Args:
        row: `metrics.step_metrics` at the end of an episode.
        ctrl_dt: control period [s].
    """
    at_start = row["crashed"] > 0 and row["length"] <= START_STEPS
    time = row["length"] * ctrl_dt if row["parked"] else math.nan
    added = {"crashed_at_start": float(at_start), "time_to_park": time}
    for name in ("min_clearance", "min_collision_time"):
        if f"{name}_{KINDS[0]}" in row:
            added[name] = min(row[f"{name}_{kind}"] for kind in KINDS)
    for metric in METRICS:
        if metric.ratio is not None and row.keys() >= {*metric.ratio}:
            above, below = (row[name] for name in metric.ratio)
            added[metric.name] = above / below if below else math.nan
    whole = row | added
    order = [metric.name for metric in METRICS if metric.name in whole]
    return {name: whole[name] for name in order} | whole


def pool(metric: Metric, rows: Sequence[dict[str, Any]]) -> float | dict[str, float]:
    """A metric of many episodes (completed rows); NaN if none of them has it.

    Quantiles are numbers of an episode, not in between two.
    """
    if metric.pool == "steps" and metric.ratio is not None:
        above, below = (math.fsum(row[name] for row in rows) for name in metric.ratio)
        return above / below if below else math.nan
    among = [row for row in rows if row["parked"]] if metric.pool == "parked" else rows
    values = [row[metric.name] for row in among if not math.isnan(row[metric.name])]
    if metric.pool in ("least", "most"):
        shares = {"median": 0.5, "p5": 0.05, "min": 0.0}
        if metric.pool == "most":
            shares = {"median": 0.5, "p95": 0.95, "max": 1.0}
        if not values:
            return dict.fromkeys(shares, math.nan)
        found = np.quantile(values, list(shares.values()), method="inverted_cdf")
        return dict(zip(shares, map(float, found), strict=True))
    return math.fsum(values) / len(values) if values else math.nan


def pool_all(rows: Sequence[dict[str, Any]]) -> dict[str, float | dict[str, float]]:
    """Every metric that the episodes (completed rows) have, by name."""
    if not rows:
        return {}
    return {
        metric.name: pool(metric, rows) for metric in METRICS if metric.name in rows[0]
    }

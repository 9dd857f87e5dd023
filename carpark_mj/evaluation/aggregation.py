"""Metrics of many episodes together, exact whatever batches they came in."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from carpark_mj.evaluation.catalogue import METRICS, START_STEPS, Metric
from carpark_mj.mdp.clearance import KINDS

OUTCOMES = ("parked", "crashed", "timed_out", "diverged")
HITS = tuple(f"hit_{kind}" for kind in KINDS)

Row = dict[str, Any]  # an episode: its metrics, and which it is, by name


def complete_row(row: Row, ctrl_dt: float) -> Row:
    """An episode with what follows from its own numbers added, in catalogue order.

    Ratios without a denominator are NaN; nothing is added whose parts are missing.

    Args:
        row: `metrics.episode_metrics` at the end of an episode.
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


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Episodes (completed rows) together.

    Returns:
        `episodes`, their number; every metric of the catalogue that they have, by its
        name, in its unit, see `pool`; and `mean_returns`, which add up to
        `episode_return`, by reward term.
    """
    names = rows[0] if rows else (*OUTCOMES, *HITS)
    returns = [name for name in names if name.startswith("return_")]
    return {
        "episodes": len(rows),
        **{
            metric.name: pool(metric, rows)
            for metric in METRICS
            if metric.name in names
        },
        "mean_returns": {
            name.removeprefix("return_"): _mean([row[name] for row in rows])
            for name in returns
        },
    }


def pool(metric: Metric, rows: Sequence[Row]) -> float | dict[str, float]:
    """A metric of many episodes (completed rows); NaN if none of them has it.

    Rates come with Wilson's 95 % interval and the count. Quantiles are numbers of an
    episode, not in between two.
    """
    if metric.pool == "steps" and metric.ratio is not None:
        above, below = (math.fsum(row[name] for row in rows) for name in metric.ratio)
        return above / below if below else math.nan
    among = [row for row in rows if row["parked"]] if metric.pool == "parked" else rows
    values = [row[metric.name] for row in among if not math.isnan(row[metric.name])]
    if metric.pool == "rate":
        count = math.fsum(values)
        low, high = wilson_interval(count, len(values))
        return {"rate": _mean(values), "low": low, "high": high, "count": count}
    if metric.pool == "least":
        return _quantiles(values, {"median": 0.5, "p5": 0.05, "min": 0.0})
    if metric.pool == "most":
        return _quantiles(values, {"median": 0.5, "p95": 0.95, "max": 1.0})
    return _mean(values)


def wilson_interval(successes: float, trials: float) -> tuple[float, float]:
    """Wilson score interval of a rate at 95 % confidence.

    Wilson 1927; keeps sensible bounds near 0 and 1. (0, 1) without trials.
    """
    if trials <= 0:
        return 0.0, 1.0
    z = 1.959964
    rate = successes / trials
    centre = rate + z * z / (2 * trials)
    spread = z * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values) if values else math.nan


def _quantiles(values: Sequence[float], shares: dict[str, float]) -> dict[str, float]:
    if not values:
        return dict.fromkeys(shares, math.nan)
    found = np.quantile(values, list(shares.values()), method="inverted_cdf")
    return dict(zip(shares, map(float, found), strict=True))

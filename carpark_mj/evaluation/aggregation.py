"""Aggregates metrics of many episodes, independent of batching."""

import itertools
import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from carpark_mj.evaluation.catalogue import START_STEPS, metrics
from carpark_mj.geometry.obstacles import ObstacleKind
from carpark_mj.mdp.metrics import Metric
from carpark_mj.types import ENDINGS

HITS = tuple(f"hit_{kind.label}" for kind in ObstacleKind)

MOVED = 0.1  # m, the path of a car that has moved
SPEEDS = (0.0, 0.5, 1.0, 2.0)  # m/s, where classes begin; the last has no end
_CONTACT = Metric("contact", "", "contact with a person at a speed of a class", "rate")

Row = dict[str, Any]  # an episode: its metrics, and which it is, by name


def complete_row(row: Row, ctrl_dt: float) -> Row:
    """An episode with derived metrics added, in catalogue order.

    Ratios without a denominator are NaN; a ratio whose parts are missing is left out.
    `ctrl_dt` is the control period [s].
    """
    at_start = row["crashed"] > 0 and row["length"] <= START_STEPS
    time = row["length"] * ctrl_dt if row["parked"] else math.nan
    added = {"crashed_at_start": float(at_start), "time_to_park": time}
    for name in ("min_clearance", "min_collision_time"):
        kinds = [f"{name}_{kind.label}" for kind in ObstacleKind]
        if found := [row[kind] for kind in kinds if kind in row]:
            added[name] = min(found)
    known = metrics()
    for metric in known:
        if metric.ratio is not None and row.keys() >= {*metric.ratio}:
            above, below = (row[name] for name in metric.ratio)
            added[metric.name] = above / below if below else math.nan
    whole = row | added
    order = [metric.name for metric in known if metric.name in whole]
    return {name: whole[name] for name in order} | whole


def summarize(rows: Sequence[Row]) -> dict[str, Any]:
    """Aggregates episodes (completed rows).

    Returns:
        `episodes`, their number; each metric of the catalogue that they have, by name
        and in its unit, see `pool`; and `mean_returns` by reward term, which add up to
        `episode_return`.
    """
    names = rows[0] if rows else (*ENDINGS, *HITS)
    found = {x.name: pool(x, rows) for x in metrics() if x.name in names}
    returns = {
        name.removeprefix("return_"): _mean([row[name] for row in rows])
        for name in names
        if name.startswith("return_")
    }
    return {"episodes": len(rows), **found, "mean_returns": returns}


def pool(metric: Metric, rows: Sequence[Row]) -> float | dict[str, float]:
    """A metric of many episodes (completed rows); NaN if none of them has it.

    Rates come with Wilson's 95 % interval for `effective_episodes` and the count.
    Quantiles are values of single episodes, without interpolation.
    """
    if metric.pool == "steps" and metric.ratio is not None:
        above, below = (math.fsum(row[name] for row in rows) for name in metric.ratio)
        return above / below if below else math.nan
    among = [row for row in rows if row["parked"]] if metric.pool == "parked" else rows
    values = [row[metric.name] for row in among if not math.isnan(row[metric.name])]
    if metric.pool == "rate":
        count = math.fsum(values)
        rate, trials = _mean(values), effective_episodes(metric.name, among)
        low, high = wilson_interval(rate * trials, trials)
        return {"rate": rate, "low": low, "high": high, "count": count}
    if metric.pool == "least":
        return _quantiles(values, {"median": 0.5, "p5": 0.05, "min": 0.0})
    if metric.pool == "most":
        return _quantiles(values, {"median": 0.5, "p95": 0.95, "max": 1.0})
    return _mean(values)


def effective_episodes(name: str, rows: Sequence[Row]) -> float:
    """Number of independent episodes that estimate a rate equally well.

    Episodes in the same lot are correlated: two agents crash together, and some lots
    are harder. The result is the number of episodes divided by the design effect (Kish
    1965, at least 1): the variance of the rate with lots as clusters and a stratum for
    each family and number of agents, divided by that of independent episodes. Episodes
    without a lot, of a single lot, or with a rate of 0 or 1 count in full, because they
    do not show how lots differ. NaN is left out.
    """
    rows = [row for row in rows if not math.isnan(row[name])]
    values = [row[name] for row in rows]
    strata: dict[Any, dict[Any, list[float]]] = defaultdict(lambda: defaultdict(list))
    for index, row in enumerate(rows):
        stratum = row.get("family"), row.get("agents_present")
        strata[stratum][row.get("lot", -1 - index)].append(row[name])
    rate, count = _mean(values), len(values)
    if not 0 < rate < 1 or sum(map(len, strata.values())) == 1:
        return count
    found = math.fsum(_variance(list(lots.values()), rate) for lots in strata.values())
    independent = _variance([[value] for value in values], rate)
    return count / max(1.0, found / independent)


def _variance(lots: Sequence[Sequence[float]], rate: float) -> float:
    """Variance of a stratum's sum, estimated from its lots (Cochran 1977, ch. 11).

    A single lot is compared with the rate of all strata.
    """
    own = _mean([value for lot in lots for value in lot]) if len(lots) > 1 else rate
    deviations = [math.fsum(lot) - own * len(lot) for lot in lots]
    scale = len(lots) / (len(lots) - 1) if len(lots) > 1 else 1.0
    return scale * math.fsum(deviation**2 for deviation in deviations)


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
    low = (centre - spread) / scale if successes > 0 else 0.0
    high = (centre + spread) / scale if successes < trials else 1.0
    return low, high


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values) if values else math.nan


def _quantiles(values: Sequence[float], shares: dict[str, float]) -> dict[str, float]:
    if not values:
        return dict.fromkeys(shares, math.nan)
    found = np.quantile(values, list(shares.values()), method="inverted_cdf")
    return dict(zip(shares, map(float, found), strict=True))


def contacts(rows: Sequence[Row]) -> dict[str, Any] | None:
    """How often people were hit by cars that moved; None without people.

    A car that never moved cannot hit a person, for people do not walk into cars.

    Returns:
        `episodes`, those in which the car moved; `any`, the rate of contacts with its
        95 % interval and count (see `pool`), and the same by class of
        speed, as in `0.5..1`.
    """
    if not rows or not {"hit_person", "peak_contact_speed"} <= rows[0].keys():
        return None
    moved = [row for row in rows if row["path"] > MOVED]
    ranges = {"any": (0.0, math.inf)}
    for low, high in itertools.pairwise((*SPEEDS, math.inf)):
        ranges[f"{low:g}..{high:g}".removesuffix("inf")] = low, high

    def hits(row: Row, low: float, high: float) -> float:
        return float(row["hit_person"] and low <= row["peak_contact_speed"] < high)

    found: dict[str, Any] = {"episodes": len(moved)}
    for name, ends in ranges.items():
        rows = [row | {"contact": hits(row, *ends)} for row in moved]
        found[name] = pool(_CONTACT, rows)
    return found

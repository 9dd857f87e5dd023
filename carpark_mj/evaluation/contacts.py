"""Contacts with people, by the speed of the car.

A car that never moved cannot hit anybody, for people do not walk into cars: episodes in
which it did not move do not count.
"""

import math
from collections.abc import Sequence
from typing import Any

from carpark_mj.evaluation.aggregation import Row, pool
from carpark_mj.mdp.metrics import Metric

MOVED = 0.1  # m, the path of a car that has moved
SPEEDS = (0.0, 0.5, 1.0, 2.0)  # m/s, where classes begin; the last has no end
_CONTACT = Metric("contact", "", "contact with a person at a speed of a class", "rate")


def contacts(rows: Sequence[Row]) -> dict[str, Any] | None:
    """How often people were hit by cars that moved; None without people.

    Args:
        rows: episodes.

    Returns:
        `episodes`, those in which the car moved; `any`, the rate of contacts with its
        95 % interval and count (see `aggregation.pool`), and the same by class of
        speed, as in `0.5..1`.
    """
    if not rows or not {"hit_person", "peak_contact_speed"} <= rows[0].keys():
        return None
    moved = [row for row in rows if row["path"] > MOVED]
    found: dict[str, Any] = {"episodes": len(moved), "any": _rate(moved, 0, math.inf)}
    for low, high in zip(SPEEDS, (*SPEEDS[1:], math.inf), strict=True):
        name = f"{low:g}.." + (f"{high:g}" if high < math.inf else "")
        found[name] = _rate(moved, low, high)
    return found


def _rate(rows: Sequence[Row], low: float, high: float) -> dict[str, float]:
    def hits(row: Row) -> float:
        return float(row["hit_person"] and low <= row["peak_contact_speed"] < high)

    rate = pool(_CONTACT, [row | {"contact": hits(row)} for row in rows])
    assert isinstance(rate, dict)
    return rate

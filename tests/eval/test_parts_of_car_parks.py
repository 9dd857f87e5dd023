"""Rates in parts of car parks: their intervals hold for parts drawn at random."""

import pytest

from car_parks import by_agents
from carpark_mj.evaluation.aggregation import wilson_interval

PARTS, LOTS = 20, 30


def episode(part, agents, parked):
    ends = {"parked": parked, "crashed": not parked, "timed_out": False}
    ends |= {"diverged": False, "crashed_at_start": False}
    which = {"family": "san_jose", "lot": part, "agents_present": agents}
    return which | {name: float(value) for name, value in ends.items()}


def test_a_part_counts_once_however_many_lots_it_has():
    rows = [
        episode(part, agents, part < 15)  # all lots of a part end alike
        for part in range(PARTS)
        for agents in (1, 2)
        for _ in range(LOTS)
    ]
    other = {**rows[0], "family": "dragon_lake"}
    for group, found in by_agents([*rows, other], "san_jose").items():
        assert found["episodes"] == PARTS * LOTS * (2 if group == "all" else 1)
        low, high = wilson_interval(15, PARTS)
        parked = found["parked"]
        assert parked["rate"] == 0.75
        assert (parked["low"], parked["high"]) == pytest.approx((low, high), abs=0.02)

"""Contacts with people are counted per episode in which the car moved, by speed."""

import pytest

from carpark_mj.evaluation.aggregation import contacts, wilson_interval


def episode(path=9.0, hit=0.0, speed=0.0):
    return {"path": path, "hit_person": hit, "peak_contact_speed": speed}


def test_every_contact_is_in_one_class_and_cars_that_stood_do_not_count():
    speeds = (0.0, 0.4, 0.5, 1.0, 1.7, 2.4)
    rows = [episode(hit=1.0, speed=speed) for speed in speeds]
    rows += [episode()] * 94 + [episode(path=0.05)] * 50
    found = contacts(rows)
    assert found is not None
    assert found.pop("episodes") == 100
    counts = {name: rate["count"] for name, rate in found.items()}
    assert counts == {"any": 6, "0..0.5": 2, "0.5..1": 1, "1..2": 2, "2..": 1}
    rate = found["any"]
    assert (rate["low"], rate["high"]) == pytest.approx(wilson_interval(6, 100))


def test_without_a_contact_there_is_an_upper_bound_and_without_people_nothing():
    found = contacts([episode()] * 40_000)
    assert found is not None
    assert found["1..2"]["low"] == 0.0
    assert found["1..2"]["high"] == pytest.approx(1e-4, rel=0.05)
    assert contacts([]) is None
    assert contacts([{"path": 1.0}]) is None

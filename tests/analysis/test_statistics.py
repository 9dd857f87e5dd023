import math

import numpy as np
import pytest

from carpark_mj.analysis import spread

RNG = np.random.default_rng(7)


def test_the_interquartile_mean_is_that_of_the_middle_half():
    values = [100.0, -20.0, 2.0, 3.0, 4.0, -50.0, 5.0, 60.0]
    assert spread([values]).iqm == pytest.approx((2 + 3 + 4 + 5) / 4)
    assert spread([[1.0, 2.0, 6.0]]).iqm == pytest.approx(3.0)


def test_a_spread_says_how_many_and_what_is_in_the_middle():
    found = spread([[1.0, 2.0, math.nan], [4.0]])
    assert (found.runs, found.median) == (3, 2.0)
    assert found.low <= found.iqm <= found.high
    found = spread([[0.5, 0.5, 0.5]])  # equal runs: no width
    assert (found.low, found.iqm, found.high) == (0.5, 0.5, 0.5)
    one = spread([[3.0]])  # no interval
    assert (one.iqm, one.median) == (3.0, 3.0)
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    none = spread([[math.nan], []])
    assert none.runs == 0
    assert math.isnan(none.iqm)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    held = 0
    for _ in range(200):
        found = spread([RNG.normal(5.0, 1.0, 20)])
        held += found.low <= 5.0 <= found.high
    assert 170 <= held <= 199  # 95 %, and a bootstrap of few is a little narrow


def test_strata_keep_differences_out_of_the_interval():
    near, far = RNG.normal(0.0, 0.01, 8), RNG.normal(10.0, 0.01, 8)
    apart, mixed = spread([near, far]), spread([np.concatenate([near, far])])
    assert apart.iqm == mixed.iqm
    assert apart.high - apart.low < 0.1
    assert mixed.high - mixed.low > 3.0

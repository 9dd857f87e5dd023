import math

import numpy as np
import pytest

from carpark_mj.analysis import interquartile_mean, outliers, spread

RNG = np.random.default_rng(7)


def test_the_interquartile_mean_is_that_of_the_middle_half():
    values = np.array([100.0, -20.0, 2.0, 3.0, 4.0, -50.0, 5.0, 60.0])
    assert interquartile_mean(values) == pytest.approx((2 + 3 + 4 + 5) / 4)
    assert interquartile_mean(np.array([1.0, 2.0, 6.0])) == pytest.approx(3.0)


def test_a_spread_says_how_many_and_what_is_in_the_middle():
    found = spread([[1.0, 2.0, math.nan], [4.0]])
    assert (found.runs, found.median) == (3, 2.0)
    assert found.low <= found.iqm <= found.high


def test_one_run_has_no_interval_and_none_has_nothing():
    one = spread([[3.0]])
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


def test_strata_keep_differences_between_points_out_of_the_interval():
    near, far = RNG.normal(0.0, 0.01, 8), RNG.normal(10.0, 0.01, 8)
    apart, mixed = spread([near, far]), spread([np.concatenate([near, far])])
    assert apart.iqm == mixed.iqm
    assert apart.high - apart.low < 0.1
    assert mixed.high - mixed.low > 3.0


def test_equal_runs_have_an_interval_of_no_width():
    found = spread([[0.5, 0.5, 0.5]])
    assert (found.low, found.iqm, found.high) == (0.5, 0.5, 0.5)


def test_a_failed_run_is_an_outlier_and_usual_ones_are_none():
    # Figure 5.9 of Tanner 2022: one of these 24 runs is the "2.9 % increase".
    published = [
        [0.9831, 0.9773, 0.8161, 0.9774, 0.9768, 0.9821],
        [0.9760, 0.9816, 0.9732, 0.9778, 0.9759, 0.9845],
        [0.9814, 0.9781, 0.9803, 0.9816, 0.9812, 0.9841],
        [0.9734, 0.9470, 0.9852, 0.9803, 0.9782, 0.9756],
    ]
    marks = outliers(published)
    found = [(i, k) for i, row in enumerate(marks) for k, far in enumerate(row) if far]
    assert found == [(0, 2), (3, 1)]


def test_of_two_runs_neither_is_an_outlier():
    assert outliers([[0.0, 1.0], [0.5, 0.5, 0.5, 0.6]])[0] == [False, False]
    assert outliers([[1.0]]) == [[False]]
    assert outliers([[math.nan] * 3]) == [[False] * 3]

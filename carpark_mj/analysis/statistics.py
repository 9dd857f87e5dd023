"""Median, interquartile mean with bootstrap intervals, and outliers of a few runs.

As Agarwal et al. 2021 recommend (arXiv 2108.13264): the interquartile mean is the mean
of the middle half; its interval comes from resampling runs within each point of a sweep
(a stratified bootstrap), so that points do not change their weight.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000
OUTLIER = 5.0  # robust standard deviations from the median of a point
_MAD = 1.4826  # times the median absolute deviation = a normal standard deviation


@dataclasses.dataclass(frozen=True)
class Spread:
    """Several numbers of the same kind.

    Attributes:
        runs: how many.
        median: their median.
        iqm: mean of the middle half; of three or fewer the mean.
        low: lower end of the interval of `iqm`; NaN of a single run.
        high: upper end of the interval.
    """

    runs: int
    median: float
    iqm: float
    low: float
    high: float


def spread(strata: Sequence[Sequence[float]]) -> Spread:
    """Describes numbers by strata, one for each point of a sweep; NaNs are left out.

    Args:
        strata: the runs of each point.
    """
    from scipy import stats

    found = [np.array(s, float)[~np.isnan(np.array(s, float))] for s in strata]
    found = [values for values in found if len(values)]
    if not found:
        return Spread(0, math.nan, math.nan, math.nan, math.nan)
    together = np.concatenate(found)
    iqm = interquartile_mean(together)
    low = high = math.nan
    repeated = [values for values in found if len(values) > 1]
    if repeated:
        single = np.array([values[0] for values in found if len(values) == 1])

        def statistic(*parts: np.ndarray, axis: int) -> np.ndarray:
            drawn = np.concatenate(parts, axis)  # axis is the last one
            same = np.broadcast_to(single, (*drawn.shape[:-1], len(single)))
            return interquartile_mean(np.concatenate((drawn, same), axis), axis)

        interval = stats.bootstrap(
            repeated,
            statistic,
            n_resamples=RESAMPLES,
            confidence_level=CONFIDENCE,
            method="percentile",
            rng=np.random.default_rng(0),
        ).confidence_interval
        low, high = float(interval.low), float(interval.high)
    return Spread(len(together), float(np.median(together)), float(iqm), low, high)


def interquartile_mean(values: np.ndarray, axis: int = 0) -> np.ndarray:
    """Mean of the middle half along an axis."""
    from scipy import stats

    return stats.trim_mean(values, 0.25, axis=axis)


def outliers(strata: Sequence[Sequence[float]]) -> list[list[bool]]:
    """Which numbers are far from the median of their stratum.

    Far is `OUTLIER` robust standard deviations of all strata together, because a single
    point has too few runs. One or two runs are never outliers.
    """
    finite = [[value for value in values if not math.isnan(value)] for values in strata]
    centres = [float(np.median(s)) if len(s) > 2 else math.nan for s in finite]
    away = [
        [abs(value - centre) for value in values]
        for values, centre in zip(strata, centres, strict=True)
    ]
    # A median is often one of the runs: its distance of 0 says nothing.
    known = [d for distances in away for d in distances if d > 0.0]
    limit = OUTLIER * _MAD * float(np.median(known)) if known else math.nan
    return [[d > limit for d in distances] for distances in away]

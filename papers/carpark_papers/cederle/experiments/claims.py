"""Conclusions of Cederle 2023 as comparisons of cells that seeds can decide.

A comparison is the probability that a run of one cell does better than one of another,
ties counted as halves, the mean over pairs of cells; its interval comes from resampling
the runs of every cell (Agarwal et al. 2021, arXiv 2108.13264).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from carpark_mj.analysis.statistics import CONFIDENCE, RESAMPLES
from carpark_papers.cederle.experiments.runs import CENTRAL, DQN, Cell, Outcome
from carpark_papers.reports import ENOUGH

Key = tuple[str, str]  # table, name of a cell
Runs = Mapping[Cell, Sequence[Outcome]]
Metric = Literal["converged_at", "final_return", "unrest"]
GREATER: tuple[Metric, ...] = ("final_return",)  # is better; of the others less


@dataclasses.dataclass(frozen=True)
class Claim:
    """A conclusion of the thesis."""

    text: str  # in its words, shortened
    metric: Metric  # of `Outcome`, by which it is judged
    # of cells; the thesis says that the first does better
    pairs: tuple[tuple[Key, Key], ...]


def _across(
    better: Sequence[str], worse: Sequence[str], tables: Sequence[str]
) -> tuple[tuple[Key, Key], ...]:
    """All pairs within tables."""
    return tuple(((t, b), (t, w)) for t in tables for b in better for w in worse)


_ALL, _HUMAN = ("6.1", "6.2", "6.3", "6.4"), ("6.2", "6.4")
_PLAIN_TO_DOUBLE = (("double", "idqn"), ("double-dueling", "dueling"))
_PLAIN_TO_DUELING = (("dueling", "idqn"), ("double-dueling", "double"))

CLAIMS = (
    Claim(
        "double Q-learning is more stable",
        "unrest",
        tuple(((t, b), (t, w)) for t in _ALL for b, w in _PLAIN_TO_DOUBLE),
    ),
    Claim(
        "dueling networks are faster",
        "converged_at",
        tuple(((t, b), (t, w)) for t in _ALL for b, w in _PLAIN_TO_DUELING),
    ),
    Claim(
        "dueling networks earn less beside a human-driven car",
        "final_return",
        tuple(((t, w), (t, b)) for t in _HUMAN for b, w in _PLAIN_TO_DUELING),
    ),
    Claim(
        "a human-driven car makes learning harder",
        "converged_at",
        tuple(
            ((without, name), (human, name))
            for without, human in (("6.1", "6.2"), ("6.3", "6.4"))
            for name in (*DQN, *CENTRAL)
        ),
    ),
    Claim("QMIX is worse than VDN", "final_return", _across(["vdn"], ["qmix"], _ALL)),
    Claim("independent learning is best", "final_return", _across(DQN, CENTRAL, _ALL)),
)


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How likely the first of a claim's pairs does better."""

    probability: float  # the mean over pairs; 0.5 = alike
    low: float  # lower end of its interval
    high: float  # upper end
    pairs: int  # that were compared
    seeds: int  # fewest runs of a cell among them; 0 = a pair is missing

    @property
    def verdict(self) -> str:
        """In words."""
        if self.seeds < ENOUGH:
            return "not decided: too few seeds"
        if self.low > 0.5:
            return "holds"
        return "does not hold: the contrary" if self.high < 0.5 else "not decided"


def compare(claim: Claim, runs: Runs) -> Comparison:
    """Judges a claim by the finished runs of its cells.

    Args:
        claim: the claim.
        runs: finished runs by cell.
    """
    sign = 1.0 if claim.metric in GREATER else -1.0
    found = {
        (cell.table, cell.name): sign
        * np.array([getattr(r, claim.metric) for r in each])
        for cell, each in runs.items()
        if each
    }
    pairs = [(b, w) for b, w in claim.pairs if b in found and w in found]
    if not pairs:
        return Comparison(np.nan, np.nan, np.nan, 0, 0)
    used = {key: found[key] for pair in pairs for key in pair}
    rng = np.random.default_rng(0)
    drawn = {
        key: rng.choice(values, (RESAMPLES, len(values)))
        for key, values in used.items()
    }
    half = (1.0 - CONFIDENCE) / 2
    low, high = np.quantile(_better(drawn, pairs), (half, 1.0 - half))
    exact = _better({key: values[None] for key, values in used.items()}, pairs)
    seeds = min(map(len, used.values())) if len(pairs) == len(claim.pairs) else 0
    return Comparison(float(exact[0]), float(low), float(high), len(pairs), seeds)


def _better(
    values: Mapping[Key, np.ndarray], pairs: Sequence[tuple[Key, Key]]
) -> np.ndarray:
    """Probability that the first do better, of each row of values."""
    means: list[np.ndarray] = []
    for better, worse in pairs:
        first, second = values[better][:, :, None], values[worse][:, None, :]
        wins = (first > second) + 0.5 * (first == second)
        means.append(wins.mean(axis=(1, 2)))
    return np.mean(means, axis=0)

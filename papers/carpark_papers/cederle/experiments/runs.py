"""The cells of the junction's tables, their trainings and outcomes, and conclusions.

A comparison of cells is the probability that a run of one does better than one of
another, ties counted as halves, the mean over pairs of cells; its interval comes from
resampling the runs of every cell (Agarwal et al. 2021, arXiv 2108.13264).
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from carpark_mj.analysis import CONFIDENCE, RESAMPLES
from carpark_mj.reading import read_csv, read_object
from carpark_papers.cederle.junction.config import CarModel
from carpark_papers.cederle.training.config import (
    Algorithm,
    JunctionPreset,
    ScenarioName,
)
from carpark_papers.cederle.training.families import presets_of
from carpark_papers.jobs import Job
from carpark_papers.reports import ENOUGH

SCENARIOS: dict[str, ScenarioName] = dict(
    zip(("6.1", "6.2", "6.3", "6.4"), get_args(ScenarioName), strict=True)
)
DQN: tuple[Algorithm, ...] = ("idqn", "double", "dueling", "double-dueling")
CENTRAL: tuple[Algorithm, ...] = ("maddpg", "vdn", "qmix")
BESIDE: tuple[Algorithm, ...] = ("ippo", "mappo")


@dataclasses.dataclass(frozen=True)
class Published:
    """The published result of a single run."""

    solved: bool  # whether an evaluation reached the scenario's threshold
    # "speed" [control steps]; None = did not converge to a value that solves
    converged_at: int | None

    @property
    def converged(self) -> bool:
        """Whether it converged to a value that solves."""
        return self.converged_at is not None


@dataclasses.dataclass(frozen=True)
class Cell:
    """An algorithm in a scenario."""

    table: str  # number in the thesis
    algorithm: Algorithm  # which
    cars: CarModel = "path"  # `path` or `mjx`
    published: Published | None = None  # None = not in the thesis

    @property
    def scenario(self) -> ScenarioName:
        """Of the table."""
        return SCENARIOS[self.table]

    @property
    def name(self) -> str:
        """The algorithm, and the cars unless they are `path`."""
        return self.algorithm + ("" if self.cars == "path" else f"-{self.cars}")


# Tables 6.1, 6.2, 6.3, 6.4: thousand steps to converge; "solved" without convergence.
_NEITHER, _SOLVED = "neither", "solved"
_TABLES: dict[Algorithm, tuple[int | str, ...]] = {
    "idqn": (100, 160, 100, 210),
    "double": (110, 170, 100, 200),
    "dueling": (100, 140, 80, 200),
    "double-dueling": (90, 140, 90, 150),
    "maddpg": (_SOLVED, _SOLVED, _NEITHER, _NEITHER),
    "vdn": (180, _SOLVED, _NEITHER, _NEITHER),
    "qmix": (_SOLVED, _SOLVED, _NEITHER, _NEITHER),
}


def _published(entry: int | str) -> Published:
    if isinstance(entry, str):
        return Published(entry == _SOLVED, None)
    return Published(True, 1000 * entry)


CELLS = tuple(
    cell
    for k, table in enumerate(SCENARIOS)
    for cell in (
        *(
            Cell(table, algorithm, published=_published(entries[k]))
            for algorithm, entries in _TABLES.items()
        ),
        *(Cell(table, name, cars) for cars in ("path", "mjx") for name in BESIDE),
    )
)


def cells_of(table: str) -> tuple[Cell, ...]:
    """The cells of a table."""
    if table not in SCENARIOS:
        raise ValueError(f"unknown table {table!r}; choose from {', '.join(SCENARIOS)}")
    return tuple(cell for cell in CELLS if cell.table == table)


# Of the steps, at the end of a curve: the last eleven of the study's 62 points.
TAIL = 1 / 6


@dataclasses.dataclass(frozen=True)
class Outcome:
    """A finished run."""

    solved_at: float  # control steps; infinity = not solved
    converged_at: float  # control steps; infinity = not converged
    final_return: float  # mean over the last sixth of the steps
    unrest: float  # standard deviation of the return over the second half of the steps
    crashed: float  # share of the last evaluation's episodes in which an agent crashed
    completed: float  # share in which all arrived
    # steps and returns of the evaluations
    curve: tuple[Sequence[float], Sequence[float]]


def make_job(cell: Cell, preset: JunctionPreset, seed: int, folder: Path) -> Job:
    """The training of a cell with a seed, in a folder below `folder`.

    Algorithms without the preset use `parallel`.
    """
    known = preset if preset in presets_of(cell.algorithm) else "parallel"
    name = f"{known}-{cell.scenario}-{cell.name}-{seed}"
    flags = ("--algorithm", cell.algorithm, "--scenario", cell.scenario)
    flags += ("--cars", cell.cars, "--preset", known, "--seed", str(seed))
    flags += ("--name", name, "--runs-dir", str(folder), "--video-episodes", "0")
    return Job("junction", folder / name, flags, is_finished)


def is_finished(folder: Path) -> bool:
    """Whether a run has been evaluated after its last step."""
    path = folder / "evaluation.json"  # rewritten at every evaluation
    if not path.exists():
        return False
    config = read_object(folder / "config.json", config=dict)["config"]
    return read_object(path, last=dict)["last"]["env_steps"] >= config["total_steps"]


def read_outcome(folder: Path) -> Outcome:
    """Reads a finished run."""
    found = read_object(folder / "evaluation.json", last=dict)
    rows = [
        (row.number("env_steps"), row.number("return"))
        for row in read_csv(folder / "evaluations.csv", "env_steps", "return")
    ]
    steps, returns = zip(*rows, strict=True)
    return Outcome(
        solved_at=_steps(found["solved_at"]),
        converged_at=_steps(found["converged_at"]),
        final_return=float(np.mean(tail(steps, returns, TAIL))),
        unrest=float(np.std(tail(steps, returns, 0.5))),
        crashed=found["last"]["crashed"],
        completed=found["last"]["completed"],
        curve=(steps, returns),
    )


def tail(steps: Sequence[float], values: Sequence[float], share: float) -> list[float]:
    """Values of the last `share` of the steps."""
    length = steps[-1] * share
    return [
        v for step, v in zip(steps, values, strict=True) if steps[-1] - step <= length
    ]


def _steps(found: float | None) -> float:
    return math.inf if found is None else float(found)


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
    """Judges a claim by the finished runs of its cells."""
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

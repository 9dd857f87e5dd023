"""The junction's tables and curves: the thesis, our results, verdicts.

`cederle_2023.csv` has the learning curves that M. Cederle's repository (mcederle99 on
GitHub, `thesis`) keeps as arrays: return of all agents, single runs. Returns of
Q-learners are means of the last 100 training episodes, random actions included.
"""

import csv
import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.files import write_atomically
from carpark_papers.cederle.experiments.runs import (
    CLAIMS,
    SCENARIOS,
    TAIL,
    Cell,
    Outcome,
    Published,
    Runs,
    compare,
    tail,
)
from carpark_papers.cederle.junction.config import scenario
from carpark_papers.reports import ENOUGH, always, make_panels, write_figure

PATH = Path(__file__).parent / "cederle_2023.csv"
THOUSAND = 1e3
LOWEST = -30.0  # shown; the study's QMIX falls to -165 for a moment

Curve = tuple[Sequence[float], Sequence[float]]  # steps, returns


def published_curve(cell: Cell) -> Curve | None:
    """The recorded run of a cell; None = there is none."""
    return _read().get((cell.scenario, cell.algorithm)) if cell.published else None


@functools.cache
def _read() -> dict[tuple[str, str], Curve]:
    found: dict[tuple[str, str], tuple[list[float], list[float]]] = {}
    with PATH.open(newline="") as file:
        for row in csv.DictReader(file):
            key = row["scenario"], row["algorithm"]
            steps, returns = found.setdefault(key, ([], []))
            steps.append(float(row["step"]))
            returns.append(float(row["return"]))
    return {**found}


def draw_curves(runs: Mapping[Cell, Sequence[Outcome]]) -> Figure:
    """Return over the steps: a line per run, the published one black.

    Args:
        runs: finished runs of the cells of a table.
    """
    figure, panels = make_panels(
        len(runs),
        "steps [thousand]; black: Cederle 2023; dashed: solved",
        "return of all agents",
    )
    for axes, (cell, outcomes) in zip(panels, runs.items(), strict=True):
        for outcome in outcomes:
            _plot(axes, outcome.curve, color="tab:blue", alpha=0.6)
        theirs = published_curve(cell)
        if theirs:
            _plot(axes, theirs, color="black")
        threshold = scenario(cell.scenario).solved
        axes.axhline(threshold, color="gray", linestyle="--", linewidth=0.8)
        axes.set_title(cell.name, fontsize="small")
        axes.set_ylim(bottom=LOWEST)
    return figure


def write_curves(path: Path, runs: Mapping[Cell, Sequence[Outcome]]) -> Path:
    """Writes `draw_curves` to a PNG."""
    return write_figure(path, draw_curves(runs))


def _plot(axes: Axes, curve: Curve, **style: Any) -> None:
    steps, returns = curve
    axes.plot([step / THOUSAND for step in steps], returns, linewidth=1.0, **style)


SAFE = 0.99  # share of episodes in which everybody gets through

_HEAD = (
    "algorithm",
    "thesis",
    "its curve",
    "solved",
    "steps to solve",
    "converged",
    "steps to converge",
    "return",
    "crashed",
    "completed",
    "verdict",
)


def verdict(published: Published | None, outcomes: Sequence[Outcome]) -> str:
    """Whether the seeds agree with a cell of the thesis.

    They agree if at least `CLEAR` of them solve, or do not, as its run did, and the
    same of convergence; `earlier` or `later` if all converging seeds converge before
    or after its run.
    """
    if published is None:
        safe = sum(
            run.completed >= SAFE and run.crashed <= 1.0 - SAFE for run in outcomes
        )
        return f"not in the thesis; everybody through: {safe} of {len(outcomes)}"
    if len(outcomes) < ENOUGH:
        return f"not decided: {len(outcomes)} seeds"
    steps = _steps(outcomes)
    found: list[str] = []
    for word, theirs, at in (
        ("solved", published.solved, steps[0]),
        ("converged", published.converged, steps[1]),
    ):
        ours = [math.isfinite(step) for step in at]
        if always(ours) is not theirs:
            found.append(f"{word} by {sum(ours)} of {len(ours)}")
    if found:
        return f"differs: {', '.join(found)}"
    if published.converged_at is None:
        return "agrees"
    converged = [step for step in steps[1] if math.isfinite(step)]
    if published.converged_at < min(converged):
        return "agrees, later"
    return "agrees" + (", earlier" if published.converged_at > max(converged) else "")


def write_report(path: Path, runs: Runs) -> None:
    """Writes a table for each of the thesis's, and one of its conclusions."""
    lines: list[str] = []
    for table, name in SCENARIOS.items():
        rows = [
            _line(_row(cell, outcomes))
            for cell, outcomes in runs.items()
            if cell.table == table and outcomes
        ]
        if rows:
            lines += [f"## Table {table}: {name}", "", *_markdown(_HEAD), *rows, ""]
    lines += ["## Conclusions", ""]
    lines += _markdown(("conclusion", "by", "probability", "pairs", "verdict"))
    for claim in CLAIMS:
        found = compare(claim, runs)
        shown = f"{found.probability:.2f} ({found.low:.2f} to {found.high:.2f})"
        cells = [claim.text, claim.metric, shown if found.pairs else ""]
        cells += [f"{found.pairs} of {len(claim.pairs)}", found.verdict]
        lines.append(_line(cells))
    text = "\n".join(lines) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def _row(cell: Cell, outcomes: Sequence[Outcome]) -> list[str]:
    solved, converged = _steps(outcomes)
    returns = [run.final_return for run in outcomes]
    cells = [cell.name, thesis(cell.published), _recorded(cell)]
    cells += [_share(solved), _median(solved), _share(converged), _median(converged)]
    spread = f"{min(returns):.1f} to {max(returns):.1f}"
    cells.append(f"{np.median(returns):.1f} ({spread})")
    cells += [f"{np.mean([run.crashed for run in outcomes]):.1%}"]
    cells += [f"{np.mean([run.completed for run in outcomes]):.1%}"]
    return [*cells, verdict(cell.published, outcomes)]


def _steps(outcomes: Sequence[Outcome]) -> tuple[list[float], list[float]]:
    """To solve and to converge, of each run."""
    solved = [run.solved_at for run in outcomes]
    return solved, [run.converged_at for run in outcomes]


def thesis(published: Published | None) -> str:
    """The thesis's result of a cell."""
    if published is None:
        return "–"
    if published.converged_at is not None:
        return f"solved, converged at {published.converged_at:,}"
    return "solved, not converged" if published.solved else "not solved"


def _recorded(cell: Cell) -> str:
    """Where the recorded curve first reaches the threshold, and its final return."""
    curve = published_curve(cell)
    if curve is None:
        return "–"
    threshold = scenario(cell.scenario).solved
    first = next((s for s, r in zip(*curve, strict=True) if r >= threshold), math.inf)
    at = f"{first:,.0f}" if math.isfinite(first) else "never"
    return f"{threshold:g} at {at}; {np.mean(tail(*curve, TAIL)):.1f}"


def _share(steps: Sequence[float]) -> str:
    """Of seeds that get there, with its interval."""
    count, seeds = sum(map(math.isfinite, steps)), len(steps)
    low, high = wilson_interval(count, seeds)
    return f"{count} of {seeds} ({low:.0%} to {high:.0%})"


def _median(steps: Sequence[float]) -> str:
    middle = float(np.median(steps))
    return f"{middle:,.0f}" if math.isfinite(middle) else "–"


def _markdown(head: Sequence[str]) -> list[str]:
    return [_line(head), "|" + "---|" * len(head)]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"

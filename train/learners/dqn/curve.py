"""The evaluations of a run as a picture and in words."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from learners.dqn.config import DQNConfig
from learners.figure import NAME, two_panels

Rows = Sequence[Mapping[str, Any]]


def plot_evaluations(folder: Path, config: DQNConfig, rows: Rows) -> Path:
    """Draws return, collisions and completions to `learning_curve.png`."""
    solved = config.junction.traffic.solved
    steps = [row["env_steps"] / 1e3 for row in rows]
    title = f"{config.algorithm}, {config.scenario}: greedy episodes"
    with two_panels(folder, title, "steps of junctions [thousand]") as (tall, low):
        tall.plot(steps, [row["return"] for row in rows], label="mean return")
        tall.axhline(solved, color="black", linestyle="--", label="solved")
        tall.set(ylabel="return of all agents")
        for name, colour in (("completed", "tab:green"), ("crashed", "tab:red")):
            low.plot(steps, [row[name] for row in rows], color=colour, label=name)
        low.set(ylabel="share of episodes", ylim=(-0.02, 1.02))
        for axes in (tall, low):
            axes.legend(loc="best", fontsize="small")
    return folder / NAME


def first_solved(rows: Rows) -> int | None:
    """Steps of the first evaluation that solved the scenario; None = none did."""
    return next((row["env_steps"] for row in rows if row["solved"]), None)


def summary(config: DQNConfig, rows: Rows) -> str:
    """A sentence about the last evaluation and the best."""
    last, best = rows[-1], max(row["return"] for row in rows)
    first = first_solved(rows)
    solved = "not solved" if first is None else f"first solved at step {first:,}"
    return (
        f"{config.algorithm}, {config.scenario}: {solved} (return of "
        f"{config.junction.traffic.solved:g}); last return {last['return']:.1f}, best "
        f"{best:.1f}; last crashed {last['crashed']:.1%}, completed "
        f"{last['completed']:.1%}"
    )

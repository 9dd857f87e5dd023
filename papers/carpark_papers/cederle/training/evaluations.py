"""Evaluations and videos of policies at the junction."""

import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.files import write_csv, write_json
from carpark_mj.rendering.renderer import RenderingError
from carpark_mj.training.loop import NAME, two_panels
from carpark_papers.cederle.junction import rules
from carpark_papers.cederle.junction.evaluation import evaluation_env
from carpark_papers.cederle.training.config import JunctionRunConfig
from carpark_papers.cederle.video import ENDS, Drive, write_drives

Rows = Sequence[Mapping[str, Any]]

WINDOW = 5  # evaluations whose mean return decides convergence


def write_evaluations(folder: Path, config: JunctionRunConfig, rows: Rows) -> None:
    """Writes `evaluations.csv`, `evaluation.json` and `learning_curve.png`."""
    write_csv(folder / "evaluations.csv", rows)
    write_json(folder / "evaluation.json", verdict(config, rows))
    _plot(folder, config, rows)


def verdict(config: JunctionRunConfig, rows: Rows) -> dict[str, Any]:
    """The verdict over all evaluations, and the rates of the last.

    *Solved*: the mean return of an evaluation reached the scenario's threshold.
    *Converged*: from some evaluation on, the mean of the last `WINDOW` of them stays
    there to the end.
    """
    threshold = config.junction.traffic.solved
    returns = [row["return"] for row in rows]
    return {
        "algorithm": config.algorithm,
        "scenario": config.scenario,
        "threshold": threshold,
        "solved_at": next((row["env_steps"] for row in rows if row["solved"]), None),
        "converged_at": _converged_at(rows, threshold),
        "best_return": max(returns),
        "last": dict(rows[-1]),
    }


def _converged_at(rows: Rows, threshold: float) -> int | None:
    """Steps from which the moving mean stays at the threshold; None = it does not."""
    returns = [row["return"] for row in rows]
    if len(returns) < WINDOW:
        return None
    means = np.convolve(returns, np.full(WINDOW, 1 / WINDOW), mode="valid")
    below = np.flatnonzero(means < threshold)
    first = 0 if not below.size else int(below[-1]) + 1
    return None if first == len(means) else rows[first + WINDOW - 1]["env_steps"]


def summary(found: Mapping[str, Any]) -> str:
    """A verdict in words."""
    solved, converged, last = found["solved_at"], found["converged_at"], found["last"]
    words = "not solved" if solved is None else f"solved at step {solved:,}"
    words += ", not converged" if converged is None else f", converged at {converged:,}"
    order = ", ".join(
        f"{name.replace('_', ' ')} {share:.0%}"
        for name, share in last.items()
        if "_before_" in name and share > 0
    )
    return (
        f"{found['algorithm']}, {found['scenario']}: {words} (return of "
        f"{found['threshold']:g}); last return {last['return']:.1f}, best "
        f"{found['best_return']:.1f}; last crashed {last['crashed']:.1%}, completed "
        f"{last['completed']:.1%}; first across: {order or 'nobody'}"
    )


def progress(row: Mapping[str, Any]) -> str:
    """An evaluation beside the bar, rich markup."""
    return (
        f"[green]return {row['return']:6.1f}[/]  crashed {row['crashed']:4.0%}  "
        f"completed {row['completed']:4.0%}"
    )


def _plot(folder: Path, config: JunctionRunConfig, rows: Rows) -> Path:
    steps = [row["env_steps"] / 1e3 for row in rows]
    title = f"{config.algorithm}, {config.scenario}: greedy episodes"
    with two_panels(folder, title, "steps of junctions [thousand]") as (tall, low):
        tall.plot(steps, [row["return"] for row in rows], label="mean return")
        threshold = config.junction.traffic.solved
        tall.axhline(threshold, color="black", linestyle="--", label="solved")
        tall.set(ylabel="return of all agents")
        for name, colour in (("completed", "tab:green"), ("crashed", "tab:red")):
            low.plot(steps, [row[name] for row in rows], color=colour, label=name)
        low.set(ylabel="share of episodes", ylim=(-0.02, 1.02))
        for axes in (tall, low):
            axes.legend(loc="best", fontsize="small")
    return folder / NAME


Act = Callable[
    [jax.Array], jax.Array
]  # observations (episodes, agents, ...) to actions


def write_video(folder: Path, config: JunctionRunConfig, act: Act) -> None:
    """Writes `video.mp4` with the first episodes of an evaluation, if there is GL."""
    if not config.video_episodes:
        return
    drives = record(config, act)
    try:
        print(f"wrote {write_drives(folder / 'video.mp4', config.junction, drives)}")
    except RenderingError as error:
        print(f"no video: {error}", file=sys.stderr)


def record(config: JunctionRunConfig, act: Act) -> list[Drive]:
    """The first `video_episodes` episodes of an evaluation, till all have ended."""
    env = evaluation_env(config.junction, config.eval_jitter)
    keys = config.evaluation_keys()[: config.video_episodes]
    state, observation = jax.jit(jax.vmap(env.reset))(keys)
    step = jax.jit(jax.vmap(env.step))
    ended = jnp.zeros((len(keys), env.num_agents, len(ENDS)), bool)
    drives: list[tuple[list[Any], ...]] = [([], [], []) for _ in keys]
    for _ in range(env.config.max_steps):
        running = np.asarray(state.active.any(axis=1))
        if not running.any():
            break
        action = act(observation)
        state, timestep = step(state, action)
        observation = timestep.observation
        ended |= jnp.stack([getattr(timestep.events, name) for name in ENDS], axis=-1)
        index = jax.vmap(lambda a: rules.parse(env.action_spec, a))(action)
        bare = dataclasses.replace(state, frames=None)
        seen = jax.device_get((bare, index, ended))
        for k in np.flatnonzero(running):
            for values, value in zip(drives[k], seen, strict=True):
                values.append(jax.tree.map(lambda x, k=k: x[k], value))
    return [Drive(*drive) for drive in drives]

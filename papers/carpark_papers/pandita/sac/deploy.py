"""Whole episodes on every kind of lot after a phase; forgetting, transfer, pictures.

Backward and forward transfer follow Lopez-Paz & Ranzato 2017, "Gradient Episodic
Memory for Continual Learning", section 2 (arXiv 1706.08840).
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.files import drawn_axes
from carpark_mj.policy.acting import Carry, Step, roll_out
from carpark_mj.training.loop import plot_learning_curve, read_metrics
from carpark_mj.types import State
from carpark_mj.wrappers.goal import GoalParking
from carpark_mj.wrappers.options import share
from carpark_papers.pandita.sac.config import Phase, SACConfig

_RATES = (("success", "tab:green"), ("crashed", "tab:red"), ("timed_out", "tab:gray"))


def plot_phases(folder: Path) -> Path:
    """Draws rates and return of the training's episodes to `learning_curve.png`."""
    ends = {row["phase"]: row["env_steps"] for row in read_metrics(folder)}
    return plot_learning_curve(
        folder,
        _RATES,
        "return",
        ("steps of cars [thousand]", 1e3),
        window=7,
        switches=sorted(ends.values())[:-1],
    )


def plot_matrix(
    path: Path, matrix: np.ndarray, phases: Sequence[str], kinds: Sequence[str]
) -> Path:
    """Draws success rates (phases, kinds): a row per phase, a column per kind."""
    size = (2.2 + 1.3 * len(kinds), 1.4 + 0.5 * len(phases))
    with drawn_axes(path, size, "success rate", "deployed on") as (axes,):
        axes.imshow(matrix, cmap="RdYlGn", vmin=-0.3, vmax=1.3, aspect="auto")
        for (row, column), value in np.ndenumerate(matrix):
            axes.text(column, row, f"{value:.0%}", ha="center", va="center")
        axes.set_xticks(range(len(kinds)), kinds)
        axes.set_yticks(range(len(phases)), phases)
        axes.set_ylabel("after")
        axes.grid(visible=False)
    return path


Rows = Sequence[dict[str, Any]]


@dataclasses.dataclass(frozen=True)
class Transfer:
    """Means over tasks; the task of a phase is to park in its kinds of lots."""

    average: float  # success after the last phase, over all tasks
    # success after the last phase less that just after the task's own, over all
    # tasks but the last; negative = forgetting. NaN of one phase
    backward: float
    # success just before the task's own phase less that of the untrained policy,
    # over all tasks but the first. NaN of one phase
    forward: float


def success_matrix(
    rows: Rows, kinds: Sequence[str], policy: str = "deterministic"
) -> np.ndarray:
    """Success rates (phases + 1, kinds), row 0 of the untrained policy; else NaN."""
    found = {
        (row["phase"], row["kind"]): row["success"]
        for row in rows
        if row["policy"] == policy
    }
    phases = int(max((row["phase"] for row in rows), default=0)) + 1
    return np.array(
        [
            [found.get((phase, kind), math.nan) for kind in kinds]
            for phase in range(phases)
        ]
    )


def transfer(
    matrix: np.ndarray, kinds: Sequence[str], phases: Sequence[Phase]
) -> Transfer:
    """Average, backward and forward transfer of a `success_matrix` of kinds."""
    number = {kind: column for column, kind in enumerate(kinds)}
    tasks = [[number[kind] for kind in phase.kinds] for phase in phases]
    success = np.stack([matrix[:, task].mean(axis=1) for task in tasks], axis=1)
    last = len(phases)
    backward = [success[last, k] - success[k + 1, k] for k in range(last - 1)]
    forward = [success[k, k] - success[0, k] for k in range(1, last)]
    mean = [float(np.mean(part)) if part else math.nan for part in (backward, forward)]
    return Transfer(float(success[last].mean()), *mean)


OUTCOMES = ("success", "crashed", "timed_out")
# Weights and observations to a distribution of actions.
Actor = Callable[[Any, jax.Array], Any]


def choose_action(
    actor: Actor,
    sampled: bool | jax.Array,
    params: Any,
    vector: jax.Array,
    key: jax.Array,
) -> jax.Array:
    """Actions (1, 2) for an observation (1, 18), sampled or deterministic.

    Its parts have the order of the dictionary from which sbx makes its input.
    """
    choices = actor(params, vector)
    return jnp.where(sampled, choices.sample(seed=key), choices.mode())


@functools.partial(jax.jit, static_argnums=(0, 1))
def _episodes(
    env: GoalParking,
    actor: Actor,
    sampled: bool | jax.Array,
    params: Any,
    keys: jax.Array,
) -> dict[str, jax.Array]:
    """One episode for each key: how it ended, its steps and mean speed [m/s]."""

    def act(state: State, vector: jax.Array, memory: Any, key: jax.Array) -> Any:
        return choose_action(actor, sampled, params, vector, key), memory

    def report(step: Step) -> dict[str, jax.Array]:
        events, active = step.timestep.events, step.before.active[0]
        speed = jnp.abs(step.timestep.motion.velocity_b[0, 0])
        return {
            "success": events.success[0],
            "crashed": events.crashed[0],
            "timed_out": events.timed_out[0],
            "steps": active,
            "distance": jnp.where(active, speed, 0.0),
        }

    def episode(key: jax.Array) -> dict[str, jax.Array]:
        reset_key, act_key = jax.random.split(key)
        start = Carry(*env.reset(reset_key))
        keys = jax.random.split(act_key, env.config.episode.max_steps)
        _, steps = roll_out(env, act, start, keys, report)
        return {name: x.sum(axis=0) for name, x in steps.items()}

    return jax.vmap(episode)(keys)


def deploy(
    config: SACConfig, actor: Actor, params: Any, kind: str, sampled: bool
) -> dict[str, Any]:
    """Rates with Wilson's intervals, mean steps and speed [m/s] on a kind of lot.

    Episodes have keys that training never uses. With fixed start and goal all
    episodes of the deterministic policy are alike.
    """
    env = share(GoalParking, config.env_of(config.layout(kind)))
    keys = jax.random.split(evaluation_key(config.seed), config.eval_episodes)
    ends = _episodes(env, actor, sampled, params, keys)
    found = {name: np.asarray(x, float) for name, x in jax.device_get(ends).items()}
    row: dict[str, Any] = {
        "kind": kind,
        "policy": "sampled" if sampled else "deterministic",
        "episodes": config.eval_episodes,
    }
    for name in OUTCOMES:
        low, high = wilson_interval(found[name].sum(), config.eval_episodes)
        row |= {name: found[name].mean(), f"{name}_low": low, f"{name}_high": high}
    row["steps"] = found["steps"].mean()
    row["speed"] = found["distance"].sum() / found["steps"].sum()
    return row


def deploy_everywhere(
    config: SACConfig, actor: Actor, params: Any, phase: int
) -> list[dict[str, Any]]:
    """Rows of `deploy` for every kind, deterministic and sampled, after a phase."""
    return [
        {"phase": phase, **deploy(config, actor, params, kind, sampled)}
        for sampled in (False, True)
        for kind in config.kinds
    ]

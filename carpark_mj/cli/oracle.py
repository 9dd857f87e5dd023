"""Says which agents of held-out lots can park within an episode.

A planner that sees and moves all cars answers for each lot at its start; what it does
not solve may still be possible, unless it is counted as impossible.

carpark_mj oracle --layout street --num-agents 8 --lots 30
carpark_mj oracle --layout dead_end,garage_row --num-agents 4 --out runs/oracle
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.cli.common import (
    MAX_EPISODES,
    enable_output_fusion,
    keep_compiled_programs,
    run_command,
)
from carpark_mj.cli.driver import adapt
from carpark_mj.cli.flags import read_flags
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.evaluation.evaluator import allot
from carpark_mj.evaluation.keys import evaluation_key, require_seed
from carpark_mj.files import require_writable, write_csv
from carpark_mj.layouts import member_shares
from carpark_mj.planning.oracle import impossible, solve
from carpark_mj.planning.policy import Sight, require_plannable, sights
from carpark_mj.registry import environment

PROGRAM = "carpark_mj oracle"
OUTCOMES = ("in time", "late", "none found", "impossible")


@dataclasses.dataclass(frozen=True)
class OracleConfig:
    """Settings of `carpark_mj oracle`.

    Attributes:
        environment: name of an environment, see `carpark_mj.registry`.
        layout: the lot, a name or a layout file, or a comma-separated list of them;
            default: that of the environment.
        num_agents: number of agents, of lots that have bays for them; default: that of
            the environment.
        lots: number of lots.
        seed: of the held-out lots; training never uses these keys.
        out: folder for `oracle.csv`, a row per agent.
    """

    environment: str = "anywhere"
    layout: str | None = None
    num_agents: int | None = None
    lots: int = 16
    seed: int = 0
    out: str = ""

    def __post_init__(self) -> None:
        require_seed(self.seed)
        if not 1 <= self.lots <= MAX_EPISODES:
            raise ValueError(
                f"lots must be at least 1 and at most {MAX_EPISODES}, not {self.lots}"
            )


def consult(config: OracleConfig) -> list[dict[str, Any]]:
    """Plans the lots, prints a table and writes the file; returns its rows.

    Raises:
        ValueError: impossible settings, or OMPL is not installed.
        OSError: the folder cannot be written.
    """
    task = environment(config.environment)
    task = adapt(task, layout=config.layout, num_agents=config.num_agents)
    env = ParkingEnv(task)
    require_plannable(env)
    if task.movers:
        raise ValueError("the oracle needs lots in which only agents move")
    file = Path(config.out) / "oracle.csv"
    if config.out:
        require_writable(file, new_folders=True)
    shares = member_shares(env.layout_config)
    member = allot(list(shares.values()), config.lots)
    keys = jax.random.split(evaluation_key(config.seed), config.lots)
    state, _ = jax.jit(jax.vmap(lambda key, n: env.reset(key, "test", n)))(keys, member)
    seconds = task.episode.max_steps * task.sim.ctrl_dt
    rows: list[dict[str, Any]] = []
    for lot, seen in enumerate(sights(state)):
        begun = {"lot": lot, "family": list(shares)[member[lot]]}
        rows += [begun | row for row in answers(seen, seconds, config.seed)]
        if config.out:  # after every lot: they take seconds each
            file.parent.mkdir(parents=True, exist_ok=True)
            write_csv(file, rows)
    print(describe(rows))
    if config.out:
        print(f"wrote {file}")
    return rows


def answers(
    seen: Sequence[Sight], seconds: float, seed: int
) -> Iterator[dict[str, Any]]:
    """A row for each agent of a lot."""
    arrival = solve(seen, seconds, seed).arrival
    found = np.isfinite(arrival)
    never = ~found if found.all() else impossible(seen)
    for agent in range(len(seen)):
        outcome = "late" if found[agent] else "none found"
        outcome = "in time" if arrival[agent] <= seconds else outcome
        yield {
            "agents_present": len(seen),
            "agent": agent,
            "outcome": "impossible" if never[agent] else outcome,
            "arrival": float(arrival[agent]),
        }


def describe(rows: list[dict[str, Any]]) -> str:
    """A table of the outcomes [%] by family and number of agents, in Markdown."""
    lines = [
        f"| family | agents | lots | {' | '.join(OUTCOMES)} | lots in time |",
        "|---|---" + "|---:" * (len(OUTCOMES) + 2) + "|",
    ]
    for cell in sorted({(row["family"], row["agents_present"]) for row in rows}):
        those = [r for r in rows if (r["family"], r["agents_present"]) == cell]
        lots: dict[int, bool] = {}
        for row in those:
            in_time = row["outcome"] == "in time"
            lots[row["lot"]] = lots.get(row["lot"], True) and in_time
        shares = [
            f"{100 * sum(row['outcome'] == name for row in those) / len(those):.1f}"
            for name in OUTCOMES
        ]
        low, high = wilson_interval(sum(lots.values()), len(lots))
        whole = 100 * sum(lots.values()) / len(lots)
        rate = f"{whole:.1f} ({100 * low:.1f} … {100 * high:.1f})"
        lines.append(f"| {' | '.join(map(str, (*cell, len(lots), *shares, rate)))} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> None:
        enable_output_fusion()
        keep_compiled_programs()
        consult(read_flags(OracleConfig, arguments, description=__doc__, prog=PROGRAM))

    return run_command("oracle", command)

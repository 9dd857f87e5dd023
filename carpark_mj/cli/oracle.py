"""`carpark_mj oracle`: which agents of held-out lots can park within an episode."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from carpark_mj.cli.clock import COMPILING, doing
from carpark_mj.cli.driver import adapted
from carpark_mj.cli.settings.driving import OracleConfig
from carpark_mj.config.checks import counted
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import wilson_interval
from carpark_mj.evaluation.evaluator import allot
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.evaluation.tables import markdown
from carpark_mj.files import require_writable, write_csv
from carpark_mj.layouts import member_shares
from carpark_mj.planning.oracle import impossible, solve
from carpark_mj.planning.policy import Sight, require_plannable, sights
from carpark_mj.registry import environment

OUTCOMES = ("in time", "late", "none found", "impossible")


def main(config: OracleConfig) -> list[dict[str, Any]]:
    """Plans the lots, prints a table and writes the file; returns its rows."""
    task = adapted(config, environment(config.environment))
    env = ParkingEnv(task)
    require_plannable(env)
    if task.movers:
        raise ValueError("the oracle needs lots in which only agents move")
    file = Path(config.out) / "oracle.csv"
    if config.out:
        require_writable(file, new_folders=True)
    shares = member_shares(env.layout_config)
    doing(COMPILING)
    member = allot(list(shares.values()), config.lots)
    keys = jax.random.split(evaluation_key(config.seed), config.lots)
    state, _ = jax.jit(jax.vmap(lambda key, n: env.reset(key, "test", n)))(keys, member)
    seconds = task.episode.max_steps * task.sim.ctrl_dt
    doing(f"planning {counted(config.lots, 'lot')}, some seconds each")
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
        outcome = "impossible" if never[agent] else outcome
        row = {"agents_present": len(seen), "agent": agent, "outcome": outcome}
        yield row | {"arrival": float(arrival[agent])}


def describe(rows: list[dict[str, Any]]) -> str:
    """A table of the outcomes [%] by family and number of agents, in Markdown."""
    cells: dict[Any, list[dict[str, Any]]] = {}
    for row in rows:
        cells.setdefault((row["family"], row["agents_present"]), []).append(row)
    table: list[dict[str, Any]] = []
    for (family, agents), those in sorted(cells.items()):
        late = {row["lot"] for row in those if row["outcome"] != "in time"}
        lots = len({row["lot"] for row in those})
        cell: dict[str, Any] = {"family": family, "agents": agents, "lots": lots}
        for name in OUTCOMES:
            share = sum(row["outcome"] == name for row in those) / len(those)
            cell[name] = f"{100 * share:.1f}"
        found = lots - len(late)
        low, high = (100 * end for end in wilson_interval(found, lots))
        rate = f"{100 * found / lots:.1f} ({low:.1f} … {high:.1f})"
        table.append(cell | {"lots in time": rate})
    return markdown(table, left=2)

"""Measures what padding costs: a square lot, the same padded, and the mixture.

python eval/padding.py

Counts agent steps of the whole environment in a square lot, in that square padded to
the maxima of the mixture, and in the mixture itself, taking turns. Rates are of the
machine it runs on; compare only figures of one run.
"""

import dataclasses
import sys
import time
from typing import Any

import jax
import tyro
from rich.console import Console
from rich.table import Table

from carpark_mj.cli.common import USER_ERRORS, one_line
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import ROWS, layout_maxima, make_layout, pad_layout


@dataclasses.dataclass(frozen=True)
class PaddingConfig:
    """Settings of `python eval/padding.py`.

    Attributes:
        batches: lots simulated at once.
        steps: control steps of 0.2 s per timing.
        repeats: timings, of which the best counts.
        vehicle: preset.
        num_agents: in each lot.
        num_parked_cars: likewise.
    """

    batches: tuple[int, ...] = (64,)
    steps: int = 10
    repeats: int = 3
    vehicle: str = "compact"
    num_agents: int = 4
    num_parked_cars: int = 12

    def __post_init__(self) -> None:
        for name in ("steps", "repeats", "num_agents"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        if not self.batches or min(self.batches) < 1:
            raise ValueError(f"batches must be positive, not {self.batches}")


def measure(config: PaddingConfig, batch: int) -> dict[str, Any]:
    """Agent steps per second, and rows of the layouts, of three lots by name."""

    def env(layout: str) -> ParkingEnv:
        return ParkingEnv(
            EnvConfig(
                layout=layout,
                vehicle=config.vehicle,
                num_agents=config.num_agents,
                num_parked_cars=config.num_parked_cars,
            )
        )

    square, mixed = env("compact"), env("mixture")
    key, action_key = jax.random.split(jax.random.key(0))
    keys = jax.random.split(key, batch)
    maxima = layout_maxima([jax.eval_shape(mixed.draw_layout, key)])
    padded = pad_layout(make_layout("compact"), maxima)
    starts = {
        "square": jax.vmap(square.reset)(keys)[0],
        "square, padded": jax.vmap(lambda k: mixed.reset_to_layout(padded, k))(keys)[0],
        "mixture": jax.vmap(mixed.reset)(keys)[0],
    }
    actions = jax.random.uniform(
        action_key, (config.steps, batch, config.num_agents, 2), minval=-1.0
    )

    def run(env: ParkingEnv) -> Any:
        def step(state: Any, action: jax.Array) -> Any:
            state, timestep = jax.vmap(env.step)(state, action)
            return state, timestep.reward

        return jax.jit(lambda state: jax.lax.scan(step, state, actions))

    # The padded square runs the program of the mixture: only its numbers differ.
    programs = {"square": run(square), "mixture": run(mixed)}
    programs["square, padded"] = programs["mixture"]
    best = dict.fromkeys(starts, float("inf"))
    for turn in range(config.repeats + 1):
        for name, state in starts.items():
            begun = time.perf_counter()
            jax.block_until_ready(programs[name](state))
            if turn:  # the first compiles
                best[name] = min(best[name], time.perf_counter() - begun)
    made = batch * config.num_agents * config.steps
    return {
        name: (
            made / best[name],
            [getattr(state.layout, f"{kind}_mask").shape[-1] for kind in ROWS],
        )
        for name, state in starts.items()
    }


def main(config: PaddingConfig) -> None:
    """Measures and prints the table.

    Raises:
        ValueError: unknown vehicle, or more cars than the lots hold.
    """
    table = Table(
        title=f"{config.num_agents} agents and {config.num_parked_cars} parked cars "
        f"in every lot, on {jax.devices()[0].device_kind}"
    )
    columns = ("layout", "lots", *(f"{kind}s" for kind in ROWS), "agent steps/s")
    for name in (*columns, "of the square"):
        table.add_column(name, justify="left" if name == "layout" else "right")
    for batch in config.batches:
        measured = measure(config, batch)
        for name, (rate, rows) in measured.items():
            share = rate / measured["square"][0]
            cells = (name, f"{batch:,}", *map(str, rows), f"{rate:,.0f}")
            table.add_row(*cells, f"{share:.1%}", end_section=name == "mixture")
    Console().print(table)


if __name__ == "__main__":
    try:
        main(tyro.cli(PaddingConfig, description=__doc__))
    except USER_ERRORS as error:
        print(f"padding: {one_line(error)}", file=sys.stderr)
        sys.exit(2)

"""Measures speed side by side: of the tyre models, or of lots with and without padding.

python eval/benchmark.py
python eval/benchmark.py --batches 8192 65536
python eval/benchmark.py --subject layouts --batches 64

`tyres` counts car-substeps of the physics alone, each model at the longest substep at
which it passes the physics report: 10 ms on brush tyres, 4 ms on contact wheels in MJX.
`layouts` counts agent steps of the whole environment in a square lot, in that square
padded to the maxima of the mixture, and in the mixture itself, taking turns. Rates are
of the machine it runs on; compare only figures of one run.
"""

import dataclasses
import sys
import time
from typing import Any, Literal

import jax
import jax.numpy as jnp
import tyro
from rich.console import Console
from rich.table import Table

from carpark_mj.command_line import USER_ERRORS, one_line
from carpark_mj.config import CONTACT_SIM_DT, EnvConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import ROWS, layout_maxima, make_layout, pad_layout
from carpark_mj.physics import ContactPhysics, MjxPhysics
from carpark_mj.vehicle import make_vehicle, preset

SIMS = {
    "brush": SimConfig(),
    "contact": SimConfig(sim_dt=CONTACT_SIM_DT, tyres="contact"),
}


@dataclasses.dataclass(frozen=True)
class BenchmarkConfig:
    """Settings of `python eval/benchmark.py`.

    Attributes:
        subject: what is compared.
        batches: cars simulated at once; of `layouts` the lots.
        steps: control steps of 0.2 s per timing.
        repeats: timings, of which the best counts.
        vehicle: preset.
        num_agents: in each of the `layouts`.
        num_parked_cars: likewise.
    """

    subject: Literal["tyres", "layouts"] = "tyres"
    batches: tuple[int, ...] = (128, 512)
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


def measure(config: BenchmarkConfig, tyres: str, batch: int) -> tuple[float, float]:
    """Car-substeps per second, and seconds of compilation."""
    sim = SIMS[tyres]
    physics = (ContactPhysics if tyres == "contact" else MjxPhysics)(sim)
    vehicle = make_vehicle(preset(config.vehicle))
    fleet = jax.tree.map(lambda x: jnp.broadcast_to(x, (batch, *x.shape)), vehicle)
    key = jax.random.key(0)
    controls = jax.random.uniform(key, (config.steps, batch, 2), minval=-1.0)
    state = physics.init(jnp.zeros((batch, 3)), fleet)
    run = jax.jit(
        lambda s: jax.lax.scan(lambda s, c: (physics.step(s, c), None), s, controls)[0]
    )
    begun = time.perf_counter()
    compiled = run.lower(state).compile()
    compiling = time.perf_counter() - begun
    jax.block_until_ready(compiled(state))
    best = float("inf")
    for _ in range(config.repeats):
        begun = time.perf_counter()
        jax.block_until_ready(compiled(state))
        best = min(best, time.perf_counter() - begun)
    return batch * config.steps * sim.num_substeps / best, compiling


def measure_layouts(config: BenchmarkConfig, batch: int) -> dict[str, Any]:
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


def layouts_table(config: BenchmarkConfig) -> Table:
    """Measures what lots cost.

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
        measured = measure_layouts(config, batch)
        for name, (rate, rows) in measured.items():
            share = rate / measured["square"][0]
            cells = (name, f"{batch:,}", *map(str, rows), f"{rate:,.0f}")
            table.add_row(*cells, f"{share:.1%}", end_section=name == "mixture")
    return table


def tyres_table(config: BenchmarkConfig) -> Table:
    """Measures what the tyre models cost.

    Raises:
        ValueError: unknown vehicle.
    """
    device = jax.devices()[0].device_kind
    table = Table(title=f"{config.vehicle} in MJX on {device}, float32")
    for name in (
        "tyres",
        "cars",
        "substep",
        "car-substeps/s",
        "x real time",
        "compile",
    ):
        table.add_column(name, justify="left" if name == "tyres" else "right")
    for tyres, sim in SIMS.items():
        for batch in config.batches:
            rate, compiling = measure(config, tyres, batch)
            table.add_row(
                tyres,
                f"{batch:,}",
                f"{1e3 * sim.sim_dt:g} ms",
                f"{rate:,.0f}",
                f"{rate * sim.sim_dt:,.0f}",
                f"{compiling:.0f} s",
            )
    return table


def main(config: BenchmarkConfig) -> None:
    """Measures and prints the table.

    Raises:
        ValueError: impossible settings.
    """
    make = layouts_table if config.subject == "layouts" else tyres_table
    Console().print(make(config))


if __name__ == "__main__":
    try:
        main(tyro.cli(BenchmarkConfig, description=__doc__))
    except USER_ERRORS as error:
        print(f"benchmark: {one_line(error)}", file=sys.stderr)
        sys.exit(2)

"""Measures the physics: car-substeps per second of both tyre models, side by side.

python eval/benchmark.py
python eval/benchmark.py --batches 8192 65536

Each model runs at the longest substep at which it passes the physics report: 10 ms on
brush tyres, 4 ms on contact wheels in MJX. Rates are of the machine it runs on; compare
only figures of one run.
"""

import dataclasses
import sys
import time

import jax
import jax.numpy as jnp
import tyro
from rich.console import Console
from rich.table import Table

from carpark_mj.command_line import USER_ERRORS, one_line
from carpark_mj.config import CONTACT_SIM_DT, SimConfig
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
        batches: cars simulated at once.
        steps: control steps of 0.2 s per timing.
        repeats: timings, of which the best counts.
        vehicle: preset.
    """

    batches: tuple[int, ...] = (128, 512)
    steps: int = 10
    repeats: int = 3
    vehicle: str = "compact"

    def __post_init__(self) -> None:
        for name in ("steps", "repeats"):
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


def main(config: BenchmarkConfig) -> None:
    """Measures and prints the table.

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
    Console().print(table)


if __name__ == "__main__":
    try:
        main(tyro.cli(BenchmarkConfig, description=__doc__))
    except USER_ERRORS as error:
        print(f"benchmark: {one_line(error)}", file=sys.stderr)
        sys.exit(2)

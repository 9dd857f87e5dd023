"""Measures the physics: car-substeps per second of both tyre models, side by side.

python eval/benchmark.py
python eval/benchmark.py --batches 8192 65536

Each model runs at the longest substep at which it passes the physics report: 10 ms on
brush tyres, 4 ms on contact wheels in MJX. Prints a markdown table, whose rows name
the device; compare only figures of one run. A GPU needs no flag: JAX takes it.
"""

import dataclasses
import os
import sys
import time

import jax
import jax.numpy as jnp
import tyro

from carpark_mj.cli.common import USER_ERRORS, one_line
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


COLUMNS = (
    "device",
    "vehicle",
    "tyres",
    "cars",
    "substep",
    "car-substeps/s",
    "x real time",
    "compile",
)


def main(config: BenchmarkConfig) -> list[list[str]]:
    """Measures and prints a markdown table, row by row; returns the rows.

    Raises:
        ValueError: unknown vehicle.
    """
    preset(config.vehicle)  # before anything is compiled
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + "---|" * 3 + "---:|" * (len(COLUMNS) - 3), flush=True)
    rows = []
    for tyres, sim in SIMS.items():
        for batch in config.batches:
            rate, compiling = measure(config, tyres, batch)
            rows.append(
                [
                    device_name(),
                    config.vehicle,
                    tyres,
                    f"{batch:,}",
                    f"{1e3 * sim.sim_dt:g} ms",
                    f"{rate:,.0f}",
                    f"{rate * sim.sim_dt:,.0f}",
                    f"{compiling:.0f} s",
                ]
            )
            print("| " + " | ".join(rows[-1]) + " |", flush=True)
    return rows


def device_name() -> str:
    """What JAX computes on: the GPU's name, or the number of CPU cores."""
    device = jax.devices()[0]
    if device.platform == "cpu":
        return f"{os.cpu_count()} CPU cores"
    return device.device_kind


if __name__ == "__main__":
    try:
        main(tyro.cli(BenchmarkConfig, description=__doc__))
    except USER_ERRORS as error:
        print(f"benchmark: {one_line(error)}", file=sys.stderr)
        sys.exit(2)

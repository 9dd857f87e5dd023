"""Soak test of the physics: 10^7 car-steps of extreme inputs.

python eval/soak.py
python eval/soak.py --car-steps 1000000 --first-case 5000000

All presets, randomised far, on anything from ice to dry asphalt, under random,
alternating, saturated and invalid inputs. Prints a table of the worst cases; exit code
1 if a car had a non-finite state, too much energy, or left the ground. A case is one
car for one episode, and its number determines everything about it.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("soak", "soak:main")

import dataclasses
import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from carpark_mj.cli.common import enable_output_fusion, run_command
from carpark_mj.config import SimConfig
from carpark_mj.config.checks import require_at_least
from carpark_mj.vehicle import PRESETS
from vehicle_suite import soak
from vehicle_suite.soak import HOLD, PATTERNS, ROUNDS, Soak, Worst


@dataclasses.dataclass(frozen=True)
class SoakConfig:
    """Settings of `python eval/soak.py`.

    Attributes:
        car_steps: total number of substeps of cars, rounded up to full batches.
        num_cars: number of cars simulated in parallel.
        first_case: number of the first case.
        max_hop: largest allowed gap between tyre and ground, at full droop [m].
        max_energy: largest allowed kinetic and spring energy per mass [J/kg]; a car at
            its speed limit of 3 m/s has 4.5.
        sim: time step, slope and surface; `ctrl_dt` is 20 ms whatever it says, so that
            hops are seen.
    """

    car_steps: int = 10_000_000
    num_cars: int = 720
    first_case: int = 0
    max_hop: float = 0.0
    max_energy: float = 8.0
    sim: SimConfig = dataclasses.field(default_factory=SimConfig)

    def __post_init__(self) -> None:
        for name in ("car_steps", "num_cars"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        require_at_least(self, 0, "max_hop", "max_energy")
        if self.first_case < 0:
            raise ValueError(f"first_case must be at least 0, not {self.first_case}")


def run(config: SoakConfig) -> int:
    """Runs the cases and prints the table; returns 1 if a case broke a limit."""
    cars = Soak(config.sim)
    substeps = ROUNDS * HOLD * cars.physics.sim.num_substeps
    num_batches = -(-config.car_steps // (substeps * config.num_cars))
    begun = time.monotonic()
    cases, worst = cars.run_batches(config.first_case, num_batches, config.num_cars)
    print_table(config, worst, cases)
    bad = soak.breaches(worst, config.max_hop, config.max_energy)
    print(
        f"{len(cases) * substeps:.3g} car-steps of {cars.physics.sim.sim_dt:g} s in "
        f"{time.monotonic() - begun:.0f} s, "
        f"{int(worst.invalid.sum())} actions sanitized; "
        + (
            f"{bad.sum()} of {len(cases)} cases broke a limit"
            if bad.any()
            else "all held"
        )
    )
    return int(bad.any())


def print_table(config: SoakConfig, worst: Worst, cases: np.ndarray) -> None:
    """The worst by preset and by pattern, with the case that reached it."""
    table = Table(title="worst found, in brackets its case")
    for column in ("cars", "cases", "non-finite"):
        table.add_column(column)
    table.add_column(f"tyre off the ground, mm (<= {1e3 * config.max_hop:g})")
    table.add_column(f"energy, J/kg (<= {config.max_energy:g})")
    groups = [(name, soak.preset_of(cases) == k) for k, name in enumerate(PRESETS)]
    groups += [(name, soak.pattern_of(cases) == k) for k, name in enumerate(PATTERNS)]
    for name, mask in groups:
        if mask.any():
            where = np.flatnonzero(mask)
            row = [name, str(len(where)), str(int(worst.broken[where].sum()))]
            for values, scale in ((worst.hop, 1e3), (worst.energy, 1.0)):
                k = where[np.argmax(values[where])]
                row.append(f"{scale * values[k]:.2f} ({cases[k]})")
            table.add_row(*row)
        if name == list(PRESETS)[-1]:
            table.add_section()
    Console().print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    enable_output_fusion()

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(SoakConfig, arguments, description=__doc__))

    return run_command("soak", command)

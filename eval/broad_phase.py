"""Measures what collisions, observations and a whole step cost, by size of the lot.

*safety* are clearance and time to collision, which a whole step leaves out by default.

python eval/broad_phase.py
python eval/broad_phase.py --lots 4 --scenes large

`square`: 7 agents and 16 parked cars in the square lot. `large`: 50 agents and 300
parked cars in a car park of 400 bays. Times are of the machine it runs on; compare only
figures of one run.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("broad_phase", "broad_phase:main")

import dataclasses
from collections.abc import Sequence

import jax
from rich.console import Console
from rich.table import Table

from carpark_mj.benchmarking.broad_phase import SCENES, make_env, measure
from carpark_mj.cli.common import enable_output_fusion, run_command
from carpark_mj.config.checks import require_at_least

COLUMNS = (
    "scene",
    "agents",
    "bays",
    "walls",
    "discs",
    "collisions",
    "observations",
    "safety",
    "whole step",
)


@dataclasses.dataclass(frozen=True)
class BroadPhaseConfig:
    """Settings of `python eval/broad_phase.py`.

    Attributes:
        scenes: scenes to measure, `square` and `large`.
        lots: number of lots in a batch.
        steps: control steps driven before and during a timing.
        repeats: number of timings; the best is reported.
        rays: number of rays observed; 0 = none.
    """

    scenes: tuple[str, ...] = tuple(SCENES)
    lots: int = 16
    steps: int = 10
    repeats: int = 5
    rays: int = 0

    def __post_init__(self) -> None:
        for name in ("lots", "steps", "repeats"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        require_at_least(self, 0, "rays")
        if not self.scenes:
            raise ValueError("scenes must name at least one")
        if unknown := set(self.scenes) - set(SCENES):
            raise ValueError(
                f"unknown scenes {sorted(unknown)}; choose from {sorted(SCENES)}"
            )


def run(config: BroadPhaseConfig) -> None:
    """Measures and prints the table."""
    device = jax.devices()[0].device_kind
    table = Table(title=f"ms a control step of {config.lots} lots on {device}")
    for name in COLUMNS:
        table.add_column(name, justify="left" if name == "scene" else "right")
    for name in config.scenes:
        env = make_env(name, config.rays)
        layout = jax.eval_shape(env.draw_layout, jax.random.key(0))
        rows = (layout.bay_mask, layout.wall_mask, layout.disc_mask)
        times = measure(env, config.lots, config.steps, config.repeats)
        table.add_row(
            name,
            str(env.num_agents),
            *(str(mask.shape[0]) for mask in rows),
            *(f"{value:.2f}" for value in times.values()),
        )
    Console().print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    enable_output_fusion()

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(BroadPhaseConfig, arguments, description=__doc__))

    return run_command("broad_phase", command)

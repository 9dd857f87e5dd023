"""Measures what a step costs by the number of agents in a lot and by its size.

python eval/scaling.py --out scaling.csv
python eval/scaling.py --read laptop.csv gpu.csv --names "2 cores" H100 --plot cost.png

The batch has the same number of agents in all, in fewer lots where a lot has more.
Compare only figures of one run.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("scaling", "scaling:main")

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import jax
from rich.console import Console
from rich.table import Table

from carpark_mj.benchmarking.scaling import (
    Point,
    draw,
    environments,
    measure,
    read_points,
    write_points,
)
from carpark_mj.cli.common import enable_output_fusion, run_command
from carpark_mj.files import require_writable


@dataclasses.dataclass(frozen=True)
class ScalingConfig:
    """Settings of `python eval/scaling.py`.

    Attributes:
        agents: number of agents in the batch, all lots together.
        steps: number of control steps in a timing.
        repeats: number of timings; the best counts.
        out: CSV file of the measurements; empty = none.
        read: CSV files to draw instead of measuring.
        names: of the devices they were measured on.
        plot: picture to draw; empty = none.
    """

    agents: int = 512
    steps: int = 10
    repeats: int = 5
    out: str = ""
    read: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    plot: str = ""

    def __post_init__(self) -> None:
        for name in ("agents", "steps", "repeats"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        if len(self.names) != len(self.read):
            raise ValueError(
                f"names must be as many as the files to read, {len(self.read)}, not "
                f"{len(self.names)}"
            )
        if self.read and not self.plot:
            raise ValueError("plot must name a picture for the files to read")


def run(config: ScalingConfig) -> None:
    """Measures or reads, then prints and draws."""
    for path in filter(None, (config.out, config.plot)):
        require_writable(Path(path))
    if config.read:
        files = zip(config.names, config.read, strict=True)
        draw(Path(config.plot), {name: read_points(Path(f)) for name, f in files})
        return
    points: list[Point] = []
    device = jax.devices()[0].device_kind
    table = Table(title=f"one control step on {device}")
    for name in ("agents a lot", "bays", "lots", "µs an agent", "µs a lot"):
        table.add_column(name, justify="right")
    for series in ("agents", "size"):
        for env in environments(series):
            args = (config.agents, config.steps, config.repeats)
            point = measure(env, series, *args)
            points.append(point)
            print(point, file=sys.stderr)
            table.add_row(
                str(point.agents),
                str(point.bays),
                str(point.lots),
                f"{point.microseconds:.3f}",
                f"{point.agents * point.microseconds:.2f}",
            )
            if config.out:
                write_points(Path(config.out), points)
        table.add_section()
    if config.plot:
        draw(Path(config.plot), {device: points})
    Console().print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    enable_output_fusion()

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(ScalingConfig, arguments, description=__doc__))

    return run_command("scaling", command)

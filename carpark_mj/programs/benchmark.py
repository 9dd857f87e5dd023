"""Measures performance: steps, training, physics, compilation and memory.

carpark_mj benchmark
carpark_mj benchmark --what env --batches 512 4096
carpark_mj benchmark --what env --layouts lot --num-agents 1 4 16
carpark_mj benchmark --what ppo --preset square --runs 1 4 16

`env` counts agent steps of the whole environment under random actions, `ppo` those of
training end to end, `physics` substeps of cars alone: on brush tyres, on the same by
`mjx.step`, and on contact tyres, each at the longest substep at which it passes the
physics report. Every measurement runs in its own process, without kept compiled
programs. Compare only figures of one run.
"""

import dataclasses
import sys
from collections.abc import Sequence
from typing import Annotated, Literal, get_args

from carpark_mj.benchmarking.report import (
    Clock,
    Job,
    What,
    WorkerError,
    markdown,
    measure,
)
from carpark_mj.cli.common import enable_output_fusion
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import Bounds, CheckedConfig, Count, Natural

Cars = Literal["brush", "mjx.step", "contact"]
Counts = Annotated[tuple[int, ...], Bounds(ge=1)]


@dataclasses.dataclass(frozen=True)
class BenchmarkConfig(CheckedConfig):
    """Settings of `carpark_mj benchmark`.

    Attributes:
        what: what to measure.
        batches: numbers of lots simulated in parallel; for `physics`, of cars.
        layouts: names of the layouts of `env`.
        cars: cars of `physics`, by tyres or stepper.
        num_agents: numbers of agents in each lot of `env`.
        num_parked_cars: number of parked cars in each lot of `env`.
        preset: preset of `ppo`, with the batch as its number of lots; `auto` chooses by
            whether there is a GPU.
        runs: numbers of runs side by side of `ppo`, each with a batch of its own.
        steps: control steps of 0.2 s per timing of `env` and `physics`; `ppo` times
            updates.
        timings: timings in each process; the best is reported.
        clock: `wall`, or `cpu`: CPU seconds of all threads of the process, for busy
            machines.
        repeats: number of rounds; each measures everything once.
        out: CSV file of all measurements, written after each; empty = none.
    """

    what: tuple[What, ...] = get_args(What)
    batches: Counts = (128,)
    layouts: tuple[str, ...] = (str(EnvConfig.layout),)
    cars: tuple[Cars, ...] = get_args(Cars)
    num_agents: Counts = (EnvConfig.num_agents,)
    num_parked_cars: Natural = EnvConfig.num_parked_cars
    preset: str = "auto"
    runs: Counts = (1,)
    steps: Count = 20
    timings: Count = 10
    clock: Clock = "wall"
    repeats: Count = 3
    out: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("what", "batches", "layouts", "cars", "num_agents", "runs"):
            if not getattr(self, name):
                raise ValueError(f"{name} must name at least one")

    def jobs(self) -> list[Job]:
        """What each round measures."""
        variants = {"env": self.layouts, "ppo": (self.preset,), "physics": self.cars}
        return [
            Job(
                what,
                variant,
                lots,
                agents,
                self.num_parked_cars,
                self.steps,
                self.timings,
                self.clock,
                runs,
            )
            for what in self.what
            for variant in variants[what]
            for agents in (self.num_agents if what == "env" else self.num_agents[:1])
            for lots in self.batches
            for runs in (self.runs if what == "ppo" else (1,))
        ]


def main(config: BenchmarkConfig) -> int:
    """Measures and prints the table; returns 1 if a process failed."""
    try:
        rounds = measure(config.jobs(), config.repeats, config.out)
    except WorkerError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    print(markdown(rounds))
    return 0


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code, 1 if a process failed."""
    from carpark_mj.cli.flags import read_flags

    enable_output_fusion()
    return main(read_flags(BenchmarkConfig, arguments, description=__doc__))

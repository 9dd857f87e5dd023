"""Measures performance: steps, training, physics, compilation and memory.

carpark_mj benchmark                                   # this checkout
carpark_mj benchmark --what env --batches 512 4096
carpark_mj benchmark --what env --layouts lot --num-agents 1 4 16
carpark_mj benchmark --what ppo --preset tanner-fixed --runs 1 4 16
carpark_mj benchmark --against main~1 --out benchmark.csv
carpark_mj benchmark --peer highway-env --batches 1024   # "carpark_mj[sb3,peers]"

`env` counts agent steps of the whole environment under random actions, `ppo` those of
training end to end, `physics` substeps of cars alone: on brush tyres, on the same by
`mjx.step`, and on contact tyres, each at the longest substep at which it passes the
physics report. Every measurement runs in its own process, without compiled programs.
With `--against` two checkouts take turns, and the ratio of this one's numbers to the
other's is printed: of the best rounds, with the range over the rounds. Compare only
figures of one run. With `--peer` the adapters to other libraries take turns with the
core they wrap, or with another gym.
"""

import contextlib
import dataclasses
import signal
import sys
from collections.abc import Sequence
from typing import Literal, get_args

from carpark_mj.benchmarking.checkouts import here, other_checkout
from carpark_mj.benchmarking.peers import Peer, comparison, subjects, take_turns
from carpark_mj.benchmarking.records import Clock, Job, What
from carpark_mj.benchmarking.report import markdown
from carpark_mj.benchmarking.run import WorkerError, measure
from carpark_mj.cli.common import enable_output_fusion
from carpark_mj.cli.process import patient_interrupts
from carpark_mj.config import EnvConfig
from carpark_mj.config.checks import require_count, require_whole

Cars = Literal["brush", "mjx.step", "contact"]


@dataclasses.dataclass(frozen=True)
class BenchmarkConfig:
    """Settings of `carpark_mj benchmark`.

    Attributes:
        what: what to measure.
        against: another checkout to take turns with: its folder, or a commit, branch
            or tag of this repository; empty = none.
        peer: compare the adapters instead: with the `core`, their compiled step, or
            with highway-env's parking.
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
        clock: `wall`, or `cpu`: CPU seconds of all threads of the process, to compare
            checkouts on a busy machine.
        repeats: number of rounds; each measures everything once.
        out: CSV file of all measurements, written after each; empty = none.
    """

    what: tuple[What, ...] = get_args(What)
    against: str = ""
    peer: Peer | None = None
    batches: tuple[int, ...] = (128,)
    layouts: tuple[str, ...] = (str(EnvConfig.layout),)
    cars: tuple[Cars, ...] = get_args(Cars)
    num_agents: tuple[int, ...] = (EnvConfig.num_agents,)
    num_parked_cars: int = EnvConfig.num_parked_cars
    preset: str = "auto"
    runs: tuple[int, ...] = (1,)
    steps: int = 20
    timings: int = 10
    clock: Clock = "wall"
    repeats: int = 3
    out: str = ""

    def __post_init__(self) -> None:
        require_whole(self, 1, "steps", "timings", "repeats")
        for name in ("batches", "runs", "num_agents"):
            for number in getattr(self, name):
                require_count(name, number, 1)
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
    if config.peer is not None:
        for lots in config.batches:
            with subjects(config.peer, lots) as found:
                print(comparison(take_turns(found, config.repeats)))
        return 0
    with contextlib.ExitStack() as stack:
        measured = [here()]
        if config.against:
            # Interrupted or terminated, it removes the checkout that it made.
            stack.enter_context(patient_interrupts())
            signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
            measured.append(stack.enter_context(other_checkout(config.against)))
        try:
            rows = measure(config.jobs(), measured, config.repeats, config.out)
        except WorkerError as error:
            print(f"benchmark: {error}", file=sys.stderr)
            return 1
    print(markdown(rows))
    return 0


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code, 1 if a process failed."""
    from carpark_mj.cli.flags import read_flags

    enable_output_fusion()
    return main(read_flags(BenchmarkConfig, arguments, description=__doc__))

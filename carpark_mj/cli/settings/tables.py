"""Settings of the commands about runs, the suite and speed."""

import dataclasses
from typing import Annotated, Literal, get_args

import tyro

from carpark_mj.config.checks import (
    MAX_SEED,
    Bounds,
    CheckedConfig,
    Count,
    Natural,
    require_unset,
)
from carpark_mj.files import require_suffix

WORST = 10  # cases of a policy and level of the suite that can be filmed
DRIVING = ("levels", "cases", "first_case", "rule", "vehicle", "seeds")
STARTED = ("default", "hope", "anywhere", "sees", "considerate")
METRICS = ("parked", "crashed", "timed_out", "length")
Names = Annotated[tuple[str, ...], tyro.conf.Positional]
What = Literal["env", "ppo", "physics", "start"]
Clock = Literal["wall", "cpu"]
Cars = Literal["brush", "mjx.step", "contact"]
Counts = Annotated[tuple[int, ...], Bounds(ge=1)]
Seeds = Annotated[tuple[int, ...], Bounds(ge=0, le=MAX_SEED)]
Films = Annotated[int, Bounds(ge=0, le=WORST)]
Cluster = Literal["local", "debug", "slurm"]


@dataclasses.dataclass(frozen=True)
class AnalysisConfig:
    """Compares runs: tables with intervals, plots against a setting, curves, one page.

    carpark_mj analysis runs/cpu-0 runs/cpu-1 runs/cpu-2
    carpark_mj analysis runs/cpu-num_agents
    carpark_mj analysis runs/cpu-num_agents --metrics parked length --by env.num_agents

    Attributes:
        runs: run folders and folders of sweeps.
        by: settings that group runs, by full name (`env.num_agents`); the first is the
            horizontal axis. Default: the settings that the sweeps vary.
        metrics: metrics of the evaluations, see the documentation's page on them.
        out: folder to write to; default: that of the sweep, else `runs/analysis`.
    """

    runs: Annotated[Names, tyro.conf.arg(metavar="RUN...")] = ()
    by: tuple[str, ...] = ()
    metrics: tuple[str, ...] = METRICS
    out: str = ""

    def __post_init__(self) -> None:
        if not self.metrics:
            raise ValueError("metrics must name at least one")


@dataclasses.dataclass(frozen=True)
class BenchmarkConfig(CheckedConfig):
    """Measures performance: steps, training, physics, compilation and memory.

    carpark_mj benchmark
    carpark_mj benchmark --what env --batches 512 4096
    carpark_mj benchmark --what env --layouts lot --num-agents 1 4 16
    carpark_mj benchmark --what ppo --preset square --runs 1 4 16
    carpark_mj benchmark --what start --batches 1

    `env` counts agent steps of the whole environment under random actions, `ppo` those
    of training end to end, `physics` substeps of cars alone: on brush tyres, on the
    same by `mjx.step`, and on contact tyres, each at the longest substep at which it
    passes the physics report. Every measurement runs in its own process, without kept
    compiled programs. Compare only figures of one run.

    `start` is the time until the first step of `environments`, compiling included, in a
    first process and in a second one, which finds the compiled programs of the first.
    One lot compiles as single environments do.

    Attributes:
        what: what to measure; `start` alone.
        batches: numbers of lots simulated in parallel; for `physics`, of cars.
        environments: registered names for `start`; `default` = `EnvConfig()`.
        layouts: names of the layouts of `env`.
        cars: cars of `physics`, by tyres or stepper.
        num_agents: numbers of agents in each lot of `env`.
        num_parked_cars: number of parked cars in each lot of `env`.
        preset: preset of `ppo`, with the batch as its number of lots; `auto` chooses by
            whether there is a GPU.
        runs: numbers of runs side by side of `ppo`, each with a batch of its own.
        steps: control steps of 0.2 s per timing; `ppo` times updates.
        timings: timings in each process; the best is reported.
        clock: `wall`, or `cpu`: CPU seconds of all threads, for busy machines.
        repeats: number of rounds; each measures everything once.
        out: CSV file of all measurements, written after each; empty = none.
    """

    what: tuple[What, ...] = ("env", "ppo", "physics")
    batches: Counts = (128,)
    environments: tuple[str, ...] = STARTED
    layouts: tuple[str, ...] = ("square",)
    cars: tuple[Cars, ...] = get_args(Cars)
    num_agents: Counts = (2,)
    num_parked_cars: Natural = 16
    preset: str = "auto"
    runs: Counts = (1,)
    steps: Count = 20
    timings: Count = 10
    clock: Clock = "wall"
    repeats: Count = 3
    out: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        lists = ("what", "batches", "layouts", "cars", "num_agents", "runs")
        for name in (*lists, "environments"):
            if not getattr(self, name):
                raise ValueError(f"{name} must name at least one")
        if "start" in self.what and len(self.what) > 1:
            raise ValueError("what must be start alone: its table has other columns")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Where(CheckedConfig):
    """Where and how a sweep runs.

    Attributes:
        cluster: `local`: processes of this machine; `slurm`: jobs of a Slurm cluster;
            `debug`: this process.
        jobs: largest number of jobs at a time; on one machine each has its own GPU, if
            there are several. 0 = one on this machine, all on a cluster.
        side_by_side: largest number of runs that a job trains in one program, if they
            differ only in seeds and in numbers such as `discount` and
            `env.reward.park`; runs with `minutes` train alone.
        slurm: what to ask Slurm for, `NAME=VALUE` each, as submitit names it:
            partition, account, time [min], gpus-per-node, mem_gb; values may be JSON,
            as in `additional_parameters='{"reservation": "lab"}'`. A job whose time
            ends is queued again and resumes.
        stochastic: evaluate sampled actions instead of the deterministic policy.
    """

    cluster: Cluster = "local"
    jobs: Natural = 0
    side_by_side: Count = 8
    slurm: tuple[str, ...] = ()
    stochastic: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cluster != "slurm":
            require_unset(self, f"with cluster {self.cluster}", "slurm")
        for setting in self.slurm:
            if not all(setting.partition("=")):
                raise ValueError(f"slurm must be NAME=VALUE each, not {setting!r}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepConfig(Where):
    """Trains every combination of some settings, with several seeds each.

    carpark_mj sweep --base cpu --set num_agents=1..4 clip=0.1,0.2 --repeats 3
    carpark_mj sweep --base gpu --set discount=0.99,0.995 --cluster slurm
    carpark_mj analysis runs/cpu-num_agents-clip    # tables, plots, a page

    The same command continues a stopped sweep: finished runs are not repeated, others
    continue from their checkpoints. `sweep.csv` in its folder has a row per run.

    Attributes:
        base: preset of `carpark_mj train` for all runs.
        set: `FIELD=VALUES` each: a setting by its dotted name or any unambiguous
            suffix, and its values, separated by commas, or by semicolons if they
            contain commas; `1..7` is a range. Every combination is trained.
        repeats: runs of every combination, with different seeds.
        seed: first seed.
        name: folder under `runs_dir`; empty = the base and the swept settings.
        runs_dir: folder of all sweeps.
    """

    base: Annotated[str, tyro.conf.arg(metavar="PRESET")]
    set: tuple[str, ...] = ()
    repeats: Count = 1
    seed: int = 0
    name: str = ""
    runs_dir: str = "runs"


@dataclasses.dataclass(frozen=True)
class SuiteConfig(CheckedConfig):
    """The suite of hard cases: one car parks in every case of some levels.

    carpark_mj suite planner anywhere
    carpark_mj suite planner runs/gpu-0 --levels extreme --rule precise --videos 3
    carpark_mj suite planner --levels tpcap --seeds 0 1 2
    carpark_mj suite planner --levels normal --seeds 1 --out runs/normal-1
    carpark_mj suite --combine runs/normal-0 runs/normal-1 --videos 3
    carpark_mj suite hope anywhere --levels tpcap metadrive san_jose busy sheets

    The result is a table (Markdown, CSV, HTML). The documentation defines the cases
    and the numbers.

    Attributes:
        policies: pretrained policies, run folders, checkpoint files, `planner`, `zero`,
            `random`, or those of other libraries, `onnx:FILE`, `sb3:FILE`, `torch:FILE`
            and `function:MODULE:NAME`.
        environment: whose observation those of other libraries have.
        levels: levels to drive: HOPE's `normal`, `complex` and `extreme`; `tpcap`,
            TPCAP's 20 published cases; `busy`, where people, a cart or a car get in
            the way; `metadrive`, `san_jose` and `dragon_lake`, lots of other sources;
            `sheets`, twelve cars by data sheet; `scenario:FILE`; the standard tests
            `iso16787`, `ncap_rear` and `r158`, of another car as `r158:CAR`; or
            registered ones.
        cases: number of cases of each level, all of levels with fewer; None = all from
            `first_case` on.
        first_case: first case of each level, from 0.
        rule: when a car counts as parked: tanner, strict, precise, exact, metadrive, or
            a registered rule.
        vehicle: preset or file of the car.
        seeds: of the planner and of stochastic policies; each drives all cases.
        videos: number of worst cases to film for every policy and level, at most 10;
            needs off-screen OpenGL.
        combine: folders of this command to make one table of; no case is driven.
        out: folder for `suite.md`, `suite.csv`, `suite.json`, `cases.csv`, `worst.npz`,
            `suite.html` and `videos/`.
    """

    policies: Annotated[Names, tyro.conf.arg(metavar="POLICY")] = ()
    environment: str = ""
    levels: tuple[str, ...] = ("normal", "complex", "extreme")
    cases: Count | None = None
    first_case: Natural = 0
    rule: str = "strict"
    vehicle: str = "tpcap"
    seeds: Seeds = (0,)
    videos: Films = 0
    combine: tuple[str, ...] = ()
    out: str = "runs/suite"

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.policies) == bool(self.combine):
            raise ValueError(
                "name at least one policy, for example planner, or folders to combine"
                f"{', not both' if self.policies else ''}"
            )
        if self.combine:
            require_unset(self, "with --combine, which drives nothing", *DRIVING)
        for name in ("policies", "levels", "seeds", "combine"):
            value = getattr(self, name)
            if len({*value}) < len(value):
                raise ValueError(f"{name} must differ from each other, not {value}")
            if not value and name in ("levels", "seeds"):
                raise ValueError(f"{name} must not be empty")


@dataclasses.dataclass(frozen=True)
class ScenarioConfig(CheckedConfig):
    """One case of your own, repeated with tolerances.

    carpark_mj scenario child.yaml planner valet
    carpark_mj scenario child.yaml valet --videos 3 --out runs/child
    carpark_mj scenario child.yaml valet --repetitions 1000

    The documentation describes the file. The result is a table (Markdown, CSV, HTML)
    with 95 % intervals, as of `carpark_mj suite`.

    Attributes:
        file: the scenario, .yaml or .json.
        policies: pretrained policies, run folders, checkpoint files, `planner`, `zero`,
            `random`, `actions:FILE.csv`, recorded actions, or those of other libraries,
            as in `carpark_mj suite`.
        environment: whose observation those of other libraries have.
        repetitions: how many, instead of the file's; the first ones do not change.
        seeds: of the planner and of stochastic policies; each drives all repetitions.
        videos: number of worst repetitions to film for every policy, at most 10; needs
            off-screen OpenGL.
        out: folder for the files.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    policies: Annotated[Names, tyro.conf.arg(metavar="POLICY")]
    environment: str = ""
    repetitions: Natural = 0
    seeds: Seeds = (0,)
    videos: Films = 0
    out: str = "runs/scenario"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.policies:
            raise ValueError("name at least one policy, for example planner")


@dataclasses.dataclass(frozen=True)
class ReportConfig:
    """One printable page about runs of `suite` and `scenario`, with limits.

    carpark_mj report runs/scenario
    carpark_mj report runs/child runs/door --limits "parked>=0.95" "crashed<=0.01"
    carpark_mj report runs/scenario --limits "final_distance<=0.1" --out report.html

    A limit names a rate (parked, crashed, timed_out, hit_person, hit_mover, near_miss),
    which its 95 % interval must keep, or a value (final_distance, final_heading,
    time_to_park, gear_changes, path, min_clearance, least_gap, contact_speed,
    peak_acceleration), which every repetition must
    keep. The first five are those of parked repetitions.

    Attributes:
        runs: folders that `suite` or `scenario` wrote; films there are embedded.
        limits: each NAME>=VALUE or NAME<=VALUE.
        title: of the page; default: that of the runs.
        out: the page.
    """

    runs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    limits: tuple[str, ...] = ()
    title: str = ""
    out: str = "report.html"

    def __post_init__(self) -> None:
        if not self.runs:
            raise ValueError("name at least one folder, for example runs/scenario")
        require_suffix("out", self.out, ".html")

"""Settings of a sweep."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from carpark_mj.config.checks import Count, Natural, require_bounds
from carpark_mj.sweeps.axes import read_axis
from carpark_mj.sweeps.executor import Cluster
from carpark_mj.sweeps.manage import Where
from carpark_mj.sweeps.plan import Plan
from carpark_mj.sweeps.slurm import SlurmConfig
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.run_folder import RunConfig


@dataclasses.dataclass(frozen=True)
class SweepConfig:
    """Settings of `carpark_mj sweep`.

    Attributes:
        base: preset of `carpark_mj train` for all runs.
        set: `FIELD=VALUES` each: a setting by its dotted name or any unambiguous
            suffix, and its values, separated by commas, or by semicolons if they
            contain commas; `1..7` is a range. Every combination is trained.
        repeats: runs of every combination, with different seeds.
        seed: first seed.
        name: folder under `runs_dir`; empty = the base and the swept settings.
        runs_dir: folder of all sweeps.
        stochastic: evaluate sampled actions instead of the deterministic policy.
        cluster: `local`: processes of this machine; `slurm`: jobs of a Slurm cluster;
            `debug`: this process.
        jobs: largest number of jobs at a time; on one machine each has its own GPU, if
            there are several. 0 = one on this machine, all on a cluster.
        side_by_side: largest number of runs that a job trains in one program, if they
            differ only in seeds and in numbers such as `discount` and
            `env.reward.park`; runs with `minutes` train alone.
        slurm: resources to request from Slurm.
    """

    base: Annotated[str, tyro.conf.arg(metavar="PRESET")]
    set: tuple[str, ...] = ()
    repeats: Count = 1
    seed: int = 0
    name: str = ""
    runs_dir: str = "runs"
    stochastic: bool = False
    cluster: Cluster = "local"
    jobs: Natural = 0
    side_by_side: Count = 8
    slurm: SlurmConfig = dataclasses.field(default_factory=SlurmConfig)

    def __post_init__(self) -> None:
        require_bounds(self)
        # The rules of a run's name, folder and seeds.
        RunConfig(name=self.name, runs_dir=self.runs_dir, seed=self.seed)
        RunConfig(seed=self.seed + self.repeats - 1)
        if self.base not in PRESETS:
            raise ValueError(f"unknown base {self.base!r}; choose from {[*PRESETS]}")

    @property
    def plan(self) -> Plan:
        """The runs to train.

        Raises:
            ValueError: an unknown setting, or no values.
        """
        base = PRESETS[self.base]
        axes = tuple(read_axis(text, base) for text in self.set)
        return Plan(self.base, axes, self.repeats, self.seed)

    @property
    def where(self) -> Where:
        """Settings of the executor."""
        return Where(
            self.cluster, self.jobs, self.side_by_side, self.slurm, self.stochastic
        )


def sweep_folder(config: SweepConfig, plan: Plan) -> Path:
    """The folder of a sweep."""
    swept = [axis.fields[0].rpartition(".")[2] for axis in plan.axes if axis.is_swept]
    return Path(config.runs_dir) / (config.name or "-".join((plan.base, *swept)))

"""Settings of the study's script."""

import dataclasses

from carpark_mj.config.checks import require_at_least
from carpark_mj.sweeps.executor import Cluster
from carpark_mj.sweeps.manage import Where
from carpark_mj.sweeps.slurm import SlurmConfig


@dataclasses.dataclass(frozen=True)
class StudyConfig:
    """Settings of `carpark_mj study tanner`.

    Attributes:
        figure: number of a figure, `5.8`.
        all: all figures, those of the fewest programs first.
        list: list the figures and train none.
        minutes: budget [min]; figures that do not fit are named and left out. 0 = no
            limit.
        repeats: runs of every combination; 0 = as many as are published.
        seed: first seed.
        set: settings of all runs instead of the study's, `FIELD=VALUE` as in
            `carpark_mj sweep`.
        runs_dir: folder of the sweeps.
        cluster: see `carpark_mj sweep`.
        jobs: see `carpark_mj sweep`.
        side_by_side: see `carpark_mj sweep`.
        slurm: resources to request from Slurm.
    """

    figure: str = ""
    all: bool = False
    list: bool = False
    minutes: float = 0.0
    repeats: int = 0
    seed: int = 0
    set: tuple[str, ...] = ()
    runs_dir: str = "runs/study"
    cluster: Cluster = "local"
    jobs: int = 0
    side_by_side: int = 8
    slurm: SlurmConfig = dataclasses.field(default_factory=SlurmConfig)

    def __post_init__(self) -> None:
        require_at_least(self, 0, "minutes", "repeats", "seed", "jobs")
        require_at_least(self, 1, "side_by_side")
        if bool(self.figure) + self.all + self.list != 1:
            raise ValueError("give one of --figure NUMBER, --all and --list")

    @property
    def where(self) -> Where:
        """Settings of the executor; the study samples actions."""
        return Where(self.cluster, self.jobs, self.side_by_side, self.slurm, True)

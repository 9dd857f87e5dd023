"""Searches settings of PPO with Optuna; every trial is a job of submitit.

    pip install -e ".[train,sweep]" optuna
    python examples/optuna_search.py --trials 16 --jobs 2 --minutes 3
    python examples/optuna_search.py --trials 64 --jobs 8 --cluster slurm --preset gpu

Trials share `search.log` in `--out` and learn from each other; one that does worse than
the median ends early. Started again, the search goes on.
"""

import dataclasses
import os
import sys
from pathlib import Path
from statistics import fmean

import optuna
import submitit
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enter
from carpark_mj.config.checks import CheckedConfig, Count, Positive
from carpark_mj.training import PRESETS, train

PARTS = 10  # of a training, after each of which trials are compared


@dataclasses.dataclass(frozen=True)
class Settings(CheckedConfig):
    """Settings of the example.

    Attributes:
        trials: number of trainings.
        jobs: number of trainings at once.
        minutes: duration of a training [min].
        preset: settings that are not searched.
        cluster: `local`, `slurm`, or `debug` for this process.
        gpus: of a job.
        out: folder of the search and its runs.
    """

    trials: Count = 16
    jobs: Count = 1
    minutes: Positive = 3.0
    preset: str = "cpu"
    cluster: str = "local"
    gpus: int = 0
    out: Path = Path("runs/search")


def open_study(settings: Settings) -> optuna.Study:
    """The study in the folder, new or begun."""
    settings.out.mkdir(parents=True, exist_ok=True)
    return optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(settings.out / "search.log"))),
        study_name="ppo",
        direction="maximize",
        pruner=optuna.pruners.MedianPruner(n_startup_trials=4, n_warmup_steps=2),
        load_if_exists=True,
    )


def drive(settings: Settings) -> None:
    """The work of a job: one trial."""

    def objective(trial: optuna.Trial) -> float:
        """Rate of parked episodes in the last part of a training."""
        config = dataclasses.replace(
            PRESETS[settings.preset],
            learning_rate=trial.suggest_float("learning_rate", 3e-4, 1e-2, log=True),
            entropy_cost=trial.suggest_float("entropy_cost", 1e-4, 3e-2, log=True),
            discount=1.0 - trial.suggest_float("1 - discount", 3e-3, 5e-2, log=True),
            num_epochs=trial.suggest_int("num_epochs", 1, 4),
            minutes=settings.minutes,
            name=f"trial-{trial.number}",
            runs_dir=str(settings.out),
        )
        parts: dict[int, list[float]] = {}

        def report(metrics) -> bool:
            """Reports a part that is over; whether to end here."""
            part = min(int(PARTS * metrics["progress"]), PARTS - 1)
            if parts and part not in parts:
                last = max(parts)
                trial.report(fmean(parts[last]), last)
            parts.setdefault(part, []).append(metrics["episode/parked"])
            return trial.should_prune()

        run = train(config, callback=report)
        if run.outcome == "stopped":
            raise optuna.TrialPruned
        return fmean(parts[max(parts)])

    open_study(settings).optimize(objective, n_trials=1)


def main(settings: Settings) -> None:
    """Submits the trials, waits for them and prints the best."""
    study = open_study(settings)
    os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)  # jobs import this file
    executor = submitit.AutoExecutor(settings.out / "logs", cluster=settings.cluster)
    minutes = 30 + 2 * round(settings.minutes)  # compiling and queueing included
    executor.update_parameters(timeout_min=minutes, gpus_per_node=settings.gpus)
    for first in range(0, settings.trials, settings.jobs):
        count = min(settings.jobs, settings.trials - first)
        jobs = [executor.submit(drive, settings) for _ in range(count)]
        for job in jobs:
            job.result()
        if any(trial.value is not None for trial in study.trials):
            best = f"{study.best_value:.1%} parked with {study.best_params}"
            print(f"{len(study.trials)} trials, best {best}", flush=True)


def run() -> None:
    """Searches with the settings on the command line."""
    main(read_flags(Settings, description=__doc__))


if __name__ == "__main__":
    enter("optuna_search", "optuna_search:run")

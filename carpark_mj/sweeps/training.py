"""How the runs of a sweep are trained with PPO, and evaluated."""

import dataclasses
import shutil
from pathlib import Path

from carpark_mj.policy.runs import checkpoint_files
from carpark_mj.sweeps.evaluation import GroupEvaluation
from carpark_mj.sweeps.outcomes import run_folder
from carpark_mj.sweeps.plan import Run, settings_of
from carpark_mj.sweeps.work import Tell, describe
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS, summaries
from carpark_mj.training.ppo.run import finish, train_runs
from carpark_mj.training.ppo.train import MAX_SKIPPED
from carpark_mj.training.settings import read_settings


def train_ppo(runs: list[Run], sweep: Path, stochastic: bool, tell: Tell) -> None:
    """Trains runs side by side, from their last checkpoints on, and evaluates them.

    Args:
        runs: that can share a program.
        sweep: folder of the sweep.
        stochastic: evaluate sampled actions.
        tell: called with what becomes of each run.

    Raises:
        ValueError: impossible settings.
        CheckpointError: a damaged checkpoint.
    """
    for part in _by_checkpoint(runs, sweep):
        by_folder = {run_folder(sweep, run): run for run in part}
        configs = [_settings(run, sweep) for run in part]
        evaluate = GroupEvaluation(configs, stochastic)

        def finish_run(
            config: PPOConfig,
            folder: Path,
            by_folder: dict[Path, Run] = by_folder,
            evaluate: GroupEvaluation = evaluate,
        ) -> None:
            try:
                finish(dataclasses.replace(config, eval_episodes=0), folder)
                evaluate(config, folder)
            except Exception as error:  # the others are still to be evaluated
                tell(by_folder[folder], "failed", describe(error))
            else:
                tell(by_folder[folder], "done", "")

        ended = train_runs(configs, finish_run)
        for folder, outcome in ended:
            if outcome == "stopped":
                tell(by_folder[folder], "stopped", "")
            if outcome == "diverged":
                said = f"{MAX_SKIPPED} updates in a row came out non-finite"
                tell(by_folder[folder], "failed", said)
        if any(outcome == "stopped" for _, outcome in ended):
            return


def _by_checkpoint(runs: list[Run], sweep: Path) -> list[list[Run]]:
    """Runs by the checkpoint they go on from: side by side they have the same.

    A kill between two checkpoints leaves runs of a group with different ones.
    """
    parts: dict[str, list[Run]] = {}
    for run in runs:
        files = checkpoint_files(run_folder(sweep, run))
        parts.setdefault(files[-1].name if files else "", []).append(run)
    return [*parts.values()]


def _settings(run: Run, sweep: Path) -> PPOConfig:
    """The settings of a new run, or of the run to continue."""
    folder = run_folder(sweep, run)
    if checkpoint_files(folder):
        words = ["--resume", str(folder)]
        return read_settings(PRESETS[run.base], PRESETS, words, None, (), summaries())
    shutil.rmtree(folder, ignore_errors=True)  # killed before its first checkpoint
    return dataclasses.replace(
        settings_of(run), name=run.name, runs_dir=str(folder.parent)
    )

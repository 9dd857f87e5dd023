"""PPO runs from start to end: their folders, the training, and what it leaves."""

import contextlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import jax

from carpark_mj.training import hosts
from carpark_mj.training.curve import plot_learning_curve
from carpark_mj.training.memory import require_memory
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.group import make_learner
from carpark_mj.training.ppo.train import Callback, Outcome, train
from carpark_mj.training.ppo.warm_start import require_run
from carpark_mj.training.run_folder import argument, open_run


def finish(config: PPOConfig, folder: Path) -> None:
    """Learning curve, evaluation on held-out seeds and a video of the trained policy.

    Every part is made anew from what lies in the folder.
    """
    print(f"wrote {plot_learning_curve(folder)}")
    run = argument(folder)
    if config.eval_episodes:
        from carpark_mj.cli import evaluate

        settings = evaluate.EvaluateConfig(
            run=run, episodes=config.eval_episodes, out=run
        )
        evaluate.main(settings)
    if config.video_seconds:
        from carpark_mj.cli import render

        try:
            render.main(render.RenderConfig(run=run, seconds=config.video_seconds))
        except render.RenderingError as error:
            print(f"no video: {error}", file=sys.stderr)


def train_runs(
    configs: Sequence[PPOConfig],
    finish_run: Callable[[PPOConfig, Path], None] | None = finish,
    callback: Callback | None = None,
) -> list[tuple[Path, Outcome]]:
    """Trains runs, several of them side by side, and finishes those that are done.

    Args:
        configs: of the runs; `group.program` of all is equal. All are new, or all are
            resumed.
        finish_run: called with config and folder of every run that is done.
        callback: see `train`.

    Returns:
        Folder and outcome of every run; the folders are host 0's.

    Raises:
        ValueError: impossible settings, or runs that cannot be side by side.
        CheckpointError: a checkpoint to resume from is damaged.
    """
    for config in configs:
        if not config.resume:
            require_run(config)
    learner = make_learner(configs)  # refuses impossible lots before a folder is made
    require_memory(learner.least_memory() // jax.process_count())
    hosts.require_same(repr(configs))
    with contextlib.ExitStack() as stack:
        opened = hosts.on_first(
            lambda: [stack.enter_context(open_run(config)) for config in configs]
        )
        # Others only read the checkpoint of a run to resume, if it is one.
        folders = opened or [Path(c.resume or c.runs_dir) for c in configs]
        outcomes = train(learner, folders, callback=callback)
        hosts.part()
        ended = list(zip(folders, outcomes, strict=True))
        if hosts.is_first() and finish_run is not None:
            for config, (folder, outcome) in zip(configs, ended, strict=True):
                if outcome == "done":
                    finish_run(config, folder)
    return ended

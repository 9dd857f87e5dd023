"""Trains automated cars to cross the junction by independent deep Q-learning.

    python train/junction.py                                      # runs/parallel-0
    python train/junction.py --scenario 3av-hd --algorithm dqn
    python train/junction.py --shared --observation image         # one network for all
    python train/junction.py --preset cederle                     # Cederle 2023
    python train/junction.py --resume runs/parallel-0             # continues a run
    python train/junction.py --help-all                           # every setting

It needs `pip install ".[train,junction]"`. In `runs/<name>/` lie `config.json`,
checkpoints, `metrics.csv`, `evaluations.csv` and `learning_curve.png`. Ctrl-C saves a
checkpoint and stops; a second one stops at once.
"""

import sys
from collections.abc import Sequence

from carpark_mj.cli.common import keep_compiled_programs, run_command


def run(arguments: Sequence[str] | None = None) -> None:
    """Trains."""
    from learners.dqn.config import RUN_SETTINGS
    from learners.dqn.presets import DQN_PRESETS, DQN_SUMMARIES
    from learners.settings import read_settings

    config = read_settings(
        DQN_PRESETS["parallel"],
        DQN_PRESETS,
        arguments,
        __doc__,
        RUN_SETTINGS,
        DQN_SUMMARIES,
    )
    try:
        from learners.dqn.run import train_run
    except ModuleNotFoundError as error:
        if error.name not in ("rlax", "flashbax"):
            raise
        raise ValueError(f'{error}: pip install ".[junction]"') from None
    folder, done = train_run(config)
    if done:
        print(f"done: {folder}; see {folder / 'learning_curve.png'}")
    else:
        print(f"stopped; continue with: python train/junction.py --resume {folder}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    # Without `enable_output_fusion`: XLA of jaxlib 0.10.2 aborts on the program.
    keep_compiled_programs()
    return run_command("junction", lambda: run(arguments))


if __name__ == "__main__":
    sys.exit(main())

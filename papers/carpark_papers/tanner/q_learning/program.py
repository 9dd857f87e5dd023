"""Trains by tabular Q-learning on the grid: the first experiments of Tanner 2022.

    carpark_mj study q_learning                                    # figure 5.1
    carpark_mj study q_learning --preset tanner-qlearning-recorded # as recorded
    carpark_mj study q_learning --preset tanner-qlearning-rings    # figure 5.2
    carpark_mj study q_learning --resume runs/tanner-qlearning-0   # continues a run
    carpark_mj study q_learning --help-all                         # every setting

Independent Q-learning with one table for all agents, several seeds side by side.
`runs/<name>/` has `config.json`, checkpoints, `metrics.csv` and `learning_curve.png`.
Ctrl-C saves a checkpoint and stops.
"""

from collections.abc import Sequence

from carpark_mj.cli.process import enable_output_fusion


def run(arguments: Sequence[str] | None = None) -> None:
    """Trains."""
    enable_output_fusion()
    from carpark_mj.training.run_folder import open_run, read_settings
    from carpark_papers.tanner.q_learning.config import (
        Q_PRESETS,
        Q_SUMMARIES,
        QLearningConfig,
        QLearningSettings,
    )
    from carpark_papers.tanner.q_learning.train import QLearner, train

    defaults = QLearningConfig(), Q_PRESETS, arguments
    config = read_settings(*defaults, __doc__, Q_SUMMARIES, QLearningSettings)
    learner = QLearner(config)  # refuses impossible lots before a folder is made
    with open_run(config) as folder:
        if train(config, learner, folder):
            print(f"done: {folder}; see {folder / 'learning_curve.png'}")
        else:
            print(
                f"stopped; continue with: carpark_mj study q_learning --resume {folder}"
            )

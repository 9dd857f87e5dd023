"""Trains automated cars to cross the junction.

    carpark_mj study junction                                # double-dueling Q-learning
    carpark_mj study junction --algorithm mappo --scenario 3av-hd --cars mjx
    carpark_mj study junction --algorithm qmix --preset cederle    # Cederle 2023
    carpark_mj study junction --algorithm idqn --observation image
    carpark_mj study junction --resume runs/mappo-2av-0       # continues a run
    carpark_mj study junction --algorithm vdn --help-all      # every setting of vdn

Independent Q-learning (idqn, double, dueling, double-dueling) needs
`pip install "./papers[junction]"`, the algorithms of BenchMARL (ippo, mappo, maddpg,
vdn, qmix) `pip install -e ".[train,torchrl]"`. In `runs/<name>/` lie `config.json`,
checkpoints, `metrics.csv`, `evaluations.csv`, `evaluation.json`, `learning_curve.png`
and `video.mp4`. Ctrl-C saves a checkpoint and stops; a second one stops at once.
"""

import sys
from collections.abc import Sequence

from carpark_mj.rendering.gl import choose_gl


def run(arguments: Sequence[str] | None = None) -> None:
    """Trains."""
    choose_gl()  # before MuJoCo is imported; without GL there is no video at the end
    # Without `enable_output_fusion`: XLA of jaxlib 0.10.2 aborts on Q-learning.
    from carpark_papers.cederle.training.families import (
        read_junction_settings,
        train_run,
    )

    arguments = sys.argv[1:] if arguments is None else arguments
    folder, done = train_run(read_junction_settings(arguments, __doc__))
    if done:
        print(f"done: {folder}; see {folder / 'learning_curve.png'}")
    else:
        print(f"stopped; continue with: carpark_mj study junction --resume {folder}")

"""Trains one shared parking policy for all agents with PPO (IPPO).

    python train/ppo.py                        # preset by hardware, runs/cpu-0 or gpu-0
    python train/ppo.py --resume runs/cpu-0    # continues exactly where it stopped
    python train/ppo.py --preset tanner-fixed  # the study's grid world
    python train/ppo.py --help-all             # every setting

Ctrl-C finishes the update, saves a checkpoint and stops; a second one stops at once.
"""

import os
import sys
from collections.abc import Sequence

import jax

from carpark_mj.cli.common import (
    enable_output_fusion,
    keep_compiled_programs,
    run_command,
)
from carpark_mj.rendering.gl import choose_gl


def configure_jax() -> None:
    """One CPU device per core, over which the lots are sharded; fused outputs."""
    enable_output_fusion()
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    # jaxlib 0.11.2 crashes compiling a program for several CPU devices; 0.10.2 is fine.
    if jax.__version_info__ < (0, 11):
        jax.config.update("jax_num_cpu_devices", cores or 1)


def run(arguments: Sequence[str] | None = None) -> int:
    """Trains; returns the exit code."""
    from learners.memory import require_memory
    from learners.ppo.config import RUN_SETTINGS
    from learners.ppo.learner import Learner
    from learners.ppo.presets import PRESETS, SUMMARIES
    from learners.ppo.train import TrainingDivergedError, finish, train
    from learners.run_folder import open_run
    from learners.settings import read_settings

    hardware = "gpu" if jax.default_backend() == "gpu" else "cpu"
    config = read_settings(
        PRESETS[hardware], PRESETS, arguments, __doc__, RUN_SETTINGS, SUMMARIES
    )
    learner = Learner(config)  # refuses impossible lots before a folder is made
    require_memory(learner.least_memory())
    try:
        with open_run(config) as folder:
            if not train(config, learner, folder):
                print(f"stopped; continue with: python train/ppo.py --resume {folder}")
                return 0
            finish(config, folder)
    except TrainingDivergedError as error:
        print(f"ppo: {error}", file=sys.stderr)
        return 1
    print(f"done: {folder}")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    choose_gl()  # before MuJoCo is imported; without GL there is no video at the end
    configure_jax()
    keep_compiled_programs()
    return run_command("ppo", lambda: run(arguments))


if __name__ == "__main__":
    sys.exit(main())

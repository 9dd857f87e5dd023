"""Trains one shared parking policy for all agents with PPO (IPPO).

    python train/ppo.py                        # preset by hardware, runs/cpu-0 or gpu-0
    python train/ppo.py --resume runs/cpu-0    # continues where it stopped
    python train/ppo.py --preset tanner-fixed  # the study's grid world
    python train/ppo.py --preset tanner-fixed --seeds 0..7       # runs side by side
    python train/ppo.py --help-all             # every setting
    python train/ppo.py --coordinator HOST:PORT --num-hosts 2 --host 0   # and --host 1
    srun python train/ppo.py --coordinator auto                          # a cluster

Ctrl-C finishes the update, saves a checkpoint and stops; a second one stops at once.
"""

import os
import sys
from collections.abc import Sequence

from carpark_mj.cli.common import (
    dispatch_synchronously,
    enable_output_fusion,
    keep_compiled_programs,
    run_command,
)
from carpark_mj.cli.process import enter
from carpark_mj.rendering.gl import choose_gl


def configure_jax() -> None:
    """One CPU device per core, over which the lots are sharded; fused outputs."""
    import jax

    enable_output_fusion()
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    if cores == 1:
        dispatch_synchronously()
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", cores or 1)


def run(arguments: Sequence[str] | None = None) -> int:
    """Trains, with other hosts if asked; returns the exit code."""
    choose_gl()  # before MuJoCo is imported; without GL there is no video at the end
    configure_jax()
    keep_compiled_programs()
    from learners.hosts import joined, read_hosts

    hosts, arguments = read_hosts(sys.argv[1:] if arguments is None else arguments)
    with joined(hosts):
        return run_on_host(arguments)


def run_on_host(arguments: Sequence[str]) -> int:
    """Trains on this host; returns the exit code."""
    import jax

    from learners.ppo.arguments import read_runs
    from learners.ppo.config import RUN_SETTINGS, PPOConfig
    from learners.ppo.presets import PRESETS, SUMMARIES
    from learners.ppo.run import train_runs
    from learners.ppo.train import MAX_SKIPPED
    from learners.settings import read_settings

    hardware = "gpu" if jax.default_backend() == "gpu" else "cpu"

    def read(arguments: Sequence[str]) -> PPOConfig:
        return read_settings(
            PRESETS[hardware], PRESETS, arguments, __doc__, RUN_SETTINGS, SUMMARIES
        )

    ended = train_runs(read_runs(arguments, read))
    stopped = [str(folder) for folder, outcome in ended if outcome == "stopped"]
    if stopped:
        print(
            f"stopped; continue with: python train/ppo.py --resume {' '.join(stopped)}"
        )
    for folder, outcome in ended:
        if outcome == "done":
            print(f"done: {folder}")
        if outcome == "diverged":
            print(
                f"ppo: {MAX_SKIPPED} updates in a row came out non-finite; the "
                f"checkpoints in {folder} are from before",
                file=sys.stderr,
            )
    return int(any(outcome == "diverged" for _, outcome in ended))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return run_command("ppo", lambda: run(arguments))


if __name__ == "__main__":
    enter("ppo", "ppo:main")

"""Trains one shared parking policy for all agents with PPO (IPPO).

    carpark_mj train                        # preset by hardware, runs/cpu-0 or gpu-0
    carpark_mj train --resume runs/cpu-0    # continues where it stopped
    carpark_mj train --preset dynamic --seeds 0..7       # runs side by side
    carpark_mj train --help-all             # every setting
    carpark_mj train --coordinator HOST:PORT --num-hosts 2 --host 0   # and --host 1
    srun carpark_mj train --coordinator auto                         # a cluster

Ctrl-C finishes the update, saves a checkpoint and stops; a second one stops at once.
"""

import sys
from collections.abc import Sequence


def run(arguments: Sequence[str]) -> int:
    """Trains, with other hosts if asked; returns the exit code."""
    from carpark_mj.training.hosts import joined, read_hosts

    hosts, arguments = read_hosts(arguments)
    with joined(hosts):
        return run_on_host(arguments)


def run_on_host(arguments: Sequence[str]) -> int:
    """Trains on this host; returns the exit code."""
    import jax

    from carpark_mj.training.ppo.config import RUN_SETTINGS, PPOConfig
    from carpark_mj.training.ppo.parts import PRESETS, summaries
    from carpark_mj.training.ppo.train import MAX_SKIPPED, train_runs
    from carpark_mj.training.run_folder import read_runs, read_settings

    hardware = "gpu" if jax.default_backend() == "gpu" else "cpu"

    def read(arguments: Sequence[str]) -> PPOConfig:
        return read_settings(
            PRESETS[hardware], PRESETS, arguments, __doc__, RUN_SETTINGS, summaries()
        )

    ended = train_runs(read_runs(arguments, read))
    stopped = [str(folder) for folder, outcome in ended if outcome == "stopped"]
    if stopped:
        print(f"stopped; continue with: carpark_mj train --resume {' '.join(stopped)}")
    for folder, outcome in ended:
        if outcome == "done":
            print(f"done: {folder}")
        if outcome == "diverged":
            print(
                f"ppo: {MAX_SKIPPED} updates in a row were non-finite; the "
                f"checkpoints in {folder} are older",
                file=sys.stderr,
            )
    return int(any(outcome == "diverged" for _, outcome in ended))

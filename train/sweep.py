"""Trains every combination of some settings, with several seeds each.

    python train/sweep.py --base cpu --set num_agents=1..4 clip=0.1,0.2 --repeats 3
    python train/sweep.py --base gpu --set discount=0.99,0.995 --cluster slurm
    python eval/analysis.py runs/cpu-num_agents-clip    # tables, plots, a page

The same command continues a sweep that was stopped: what is done is not run again, what
was begun goes on from its checkpoint. `sweep.csv` in its folder has a row per run.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("sweep", "sweep:main")

from collections.abc import Sequence

import jax

from carpark_mj.cli.common import enable_output_fusion, run_command


def prepare(cluster: str) -> None:
    """Sets JAX up; a process that only submits leaves the GPU to its jobs."""
    if cluster == "debug":
        from sweeps.work import set_up_jax

        set_up_jax()
    else:
        enable_output_fusion()
        jax.config.update("jax_platforms", "cpu")


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the sweep; returns the exit code, 1 if runs have failed."""
    from carpark_mj.cli.flags import read_flags
    from sweeps.config import SweepConfig, sweep_folder
    from sweeps.manage import run_sweep
    from sweeps.plan import checked_runs

    config = read_flags(SweepConfig, arguments, description=__doc__)
    plan = config.plan
    prepare(config.cluster)
    runs = checked_runs(plan)
    counts = run_sweep(sweep_folder(config, plan), plan, runs, config.where)
    return 1 if counts["failed"] else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    return run_command("sweep", lambda: run(arguments))

"""Trains every combination of some settings, with several seeds each.

    carpark_mj sweep --base cpu --set num_agents=1..4 clip=0.1,0.2 --repeats 3
    carpark_mj sweep --base gpu --set discount=0.99,0.995 --cluster slurm
    carpark_mj analysis runs/cpu-num_agents-clip    # tables, plots, a page

The same command continues a stopped sweep: finished runs are not repeated, others
continue from their checkpoints. `sweep.csv` in its folder has a row per run.
"""

from collections.abc import Sequence


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the sweep; returns the exit code, 1 if runs have failed."""
    from carpark_mj.cli.flags import read_flags
    from carpark_mj.sweeps.config import SweepConfig, sweep_folder
    from carpark_mj.sweeps.manage import run_sweep
    from carpark_mj.sweeps.plan import checked_runs
    from carpark_mj.sweeps.work import prepare

    config = read_flags(SweepConfig, arguments, description=__doc__)
    plan = config.plan
    prepare(config.cluster)
    runs = checked_runs(plan)
    counts = run_sweep(sweep_folder(config, plan), plan, runs, config.where)
    return 1 if counts["failed"] else 0

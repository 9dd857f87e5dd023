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
    from carpark_mj import sweeps
    from carpark_mj.cli.flags import read_flags

    config = read_flags(sweeps.SweepConfig, arguments, description=__doc__)
    plan = config.plan
    sweeps.prepare(config.cluster)
    runs = sweeps.checked_runs(plan)
    counts = sweeps.run_sweep(config.folder, plan, runs, config)
    return 1 if counts["failed"] else 0

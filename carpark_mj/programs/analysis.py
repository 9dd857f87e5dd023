"""Compares runs: tables with intervals, plots against a setting, curves, one page.

carpark_mj analysis runs/cpu-0 runs/cpu-1 runs/cpu-2
carpark_mj analysis runs/cpu-num_agents
carpark_mj analysis runs/cpu-num_agents --metrics parked length --by env.num_agents
"""

from collections.abc import Sequence


def run(arguments: Sequence[str] | None = None) -> None:
    """Compares."""
    from carpark_mj.cli.analysis import AnalysisConfig, main
    from carpark_mj.cli.flags import read_flags

    main(read_flags(AnalysisConfig, arguments, description=__doc__))

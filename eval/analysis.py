"""Compares runs: tables with intervals, plots against a setting, curves, one page.

python eval/analysis.py runs/cpu-0 runs/cpu-1 runs/cpu-2
python eval/analysis.py runs/cpu-num_agents
python eval/analysis.py runs/cpu-num_agents --metrics parked length --by env.num_agents
"""

from collections.abc import Sequence

from carpark_mj.cli.common import run_command
from carpark_mj.cli.process import enter


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> None:
        from carpark_mj.cli.analysis import AnalysisConfig, main
        from carpark_mj.cli.flags import read_flags

        main(read_flags(AnalysisConfig, arguments, description=__doc__))

    return run_command("analysis", command)


if __name__ == "__main__":
    enter("analysis", "analysis:run")

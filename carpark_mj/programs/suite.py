"""Policies in the held-out cases of HOPE's levels, or TPCAP's: a table (md, CSV, HTML).

docs/hard_cases.md defines the cases and the numbers.

carpark_mj suite planner anywhere
carpark_mj suite planner runs/gpu-0 --levels extreme --rule precise --videos 3
carpark_mj suite planner --levels tpcap --seeds 0 1 2
carpark_mj suite planner --levels normal --seeds 1 --out runs/normal-1
carpark_mj suite --combine runs/normal-0 runs/normal-1 --videos 3
"""

from collections.abc import Sequence

from carpark_mj.cli.common import (
    dispatch_synchronously,
    enable_output_fusion,
    keep_compiled_programs,
)
from carpark_mj.rendering.gl import choose_gl


def run(arguments: Sequence[str] | None = None) -> None:
    """Drives and reports."""
    choose_gl()  # before MuJoCo is imported
    dispatch_synchronously()
    enable_output_fusion()
    keep_compiled_programs()
    from carpark_mj.cli.driver import command_help
    from carpark_mj.cli.flags import read_flags
    from carpark_mj.suite.evaluation import SuiteConfig, main

    main(read_flags(SuiteConfig, arguments, description=command_help(__doc__)))

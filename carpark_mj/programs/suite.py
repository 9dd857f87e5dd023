"""Policies in the held-out cases of HOPE's levels, or TPCAP's: a table (md, CSV, HTML).

docs/hard_cases.md says what the cases are and what the numbers mean.

python eval/suite.py planner anywhere
python eval/suite.py planner runs/gpu-0 --levels extreme --rule precise --videos 3
python eval/suite.py planner --levels tpcap --seeds 0 1 2
python eval/suite.py planner --levels normal --seeds 1 --out runs/normal-1
python eval/suite.py --combine runs/normal-0 runs/normal-1 --videos 3
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
    from carpark_mj.cli.suite import SuiteConfig, main

    main(read_flags(SuiteConfig, arguments, description=command_help(__doc__)))

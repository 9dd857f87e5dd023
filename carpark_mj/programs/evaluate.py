"""Evaluates a policy on held-out seeds: tables, `evaluation.csv`, `evaluation.json`.

A mixture also gets a table with a row per family, and `families.csv`. docs/metrics.md
defines every number.

carpark_mj evaluate runs/cpu-0
carpark_mj evaluate runs/cpu-mixture-0
carpark_mj evaluate --policy random --episodes 500
carpark_mj evaluate --policy zero --environment square
"""

from collections.abc import Sequence

from carpark_mj.cli.common import (
    dispatch_synchronously,
    enable_output_fusion,
    keep_compiled_programs,
)


def run(arguments: Sequence[str] | None = None) -> None:
    """Evaluates."""
    dispatch_synchronously()
    enable_output_fusion()
    keep_compiled_programs()
    from carpark_mj.cli.driver import command_help
    from carpark_mj.cli.evaluate import EvaluateConfig, main
    from carpark_mj.cli.flags import read_flags

    main(read_flags(EvaluateConfig, arguments, description=command_help(__doc__)))

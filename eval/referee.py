"""Compares our car with the CommonRoad vehicle models; writes `referee.md` and a plot.

python eval/referee.py
python eval/referee.py --out runs/referee

Needs the package `commonroad-vehicle-models` (in the extra `test`).
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("referee", "referee:main")

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax

from carpark_mj.cli.common import enable_output_fusion, run_command
from carpark_mj.files import require_writable
from vehicle_suite import referee, referee_report


@dataclasses.dataclass(frozen=True)
class RefereeConfig:
    """Settings of `python eval/referee.py`.

    Attributes:
        out: folder of the report.
    """

    out: str = "docs/physics"


def run(config: RefereeConfig) -> None:
    """Drives the trials, writes the page and the plot, prints the table."""
    out = Path(config.out)
    require_writable(out / "referee.md", new_folders=True)  # refused before the work
    jax.config.update("jax_platforms", "cpu")  # one car: no work for a GPU
    found = referee.trials()
    referee_report.write_report(out, found)
    table = referee_report.table(found)
    print(f"{table}\nwrote {config.out}/referee.md and referee.png")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    enable_output_fusion()

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(RefereeConfig, arguments, description=__doc__))

    return run_command("referee", command)

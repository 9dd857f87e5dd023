"""Runs the validation suite of vehicle dynamics and writes the report.

python eval/physics_report.py
python eval/physics_report.py --presets compact --tyres brush --quick --out runs/physics

Writes `report.md`, `report.csv` and plots. Exit code 1: a row misses its tolerance.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("physics_report", "physics_report:main")

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import jax

from carpark_mj.cli.common import run_command
from carpark_mj.files import require_writable
from carpark_mj.vehicle import PRESETS, preset
from vehicle_suite.report import write_report
from vehicle_suite.suites import Tyres, drive_suites
from vehicle_suite.table import Study


@dataclasses.dataclass(frozen=True)
class ReportConfig:
    """Settings of `python eval/physics_report.py`.

    Attributes:
        presets: vehicle presets to test; default: all but those for one task (`tpcap`,
            `tanner`, `highway`).
        tyres: tyre models to test.
        out: folder of the report.
        quick: run fewer cases, with shorter runs.
    """

    presets: tuple[str, ...] = ()
    tyres: tuple[Tyres, ...] = ("brush", "contact")
    out: str = "docs/physics"
    quick: bool = False

    def __post_init__(self) -> None:
        if not self.tyres:
            raise ValueError("tyres must name at least one")
        for name in self.presets:
            preset(name)  # raises what is unknown


def command_of(config: ReportConfig) -> str:
    """The command that makes this report, wherever it is written."""
    parts = ["python eval/physics_report.py"]
    if config.presets:
        parts.append(" ".join(["--presets", *config.presets]))
    if config.tyres != ReportConfig.tyres:
        parts.append(" ".join(["--tyres", *config.tyres]))
    if config.quick:
        parts.append("--quick")
    return " ".join(parts)


def run(config: ReportConfig) -> int:
    """Runs the suite and writes the report; returns 1 if a row misses."""
    out = Path(config.out)
    require_writable(out / "report.md", new_folders=True)  # refused before the work
    jax.config.update("jax_platforms", "cpu")  # few cars: no work for a GPU
    everything = Study("", "")
    presets = config.presets or tuple(sorted(PRESETS))
    for study in drive_suites(config.tyres, presets, config.quick):
        everything.rows.extend(study.rows)
        everything.curves.extend(study.curves)
        print(f"{study.preset}, {study.tyres}: done", flush=True)
    write_report(out, everything, command_of(config))
    missed = [row for row in everything.rows if not row.passes]
    for row in missed:
        print(f"{row.preset}, {row.tyres}: {row.row}: {row.verdict}")
    print(
        f"{len(everything.rows)} rows, {len(missed)} missed; "
        f"wrote {config.out}/report.md"
    )
    return 1 if missed else 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(ReportConfig, arguments, description=__doc__))

    return run_command("physics_report", command)

"""Drives the manoeuvres of `vehicle_suite` and writes the report of vehicle dynamics.

python eval/physics_report.py
python eval/physics_report.py --presets compact --quick --out runs/physics

Writes `report.md` and `report.csv`. Exit code 1: a row misses its tolerance.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("physics_report", "physics_report:main")

import dataclasses
from collections.abc import Callable
from pathlib import Path

import jax

from carpark_mj.files import require_writable
from carpark_mj.vehicle import PRESETS, preset
from shell import command
from vehicle_suite import engines, manoeuvres
from vehicle_suite.report import Study, write_report

SUITE: tuple[Callable[[Study], None], ...] = (
    manoeuvres.turning, manoeuvres.stops, manoeuvres.straight, manoeuvres.slope_hold,
    manoeuvres.lateral_limit, manoeuvres.understeer,
    engines.convergence, engines.reversing, engines.taps,
    engines.brush, engines.contact,
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class ReportConfig:
    """Settings of `python eval/physics_report.py`.

    Attributes:
        presets: vehicle presets to test; default: all except task-specific ones
            (`tpcap`, `tanner`, `highway`).
        out: folder of the report.
        quick: run fewer cases, with shorter runs.
    """

    presets: tuple[str, ...] = ()
    out: str = "docs/physics"
    quick: bool = False

    def __post_init__(self) -> None:
        for name in self.presets:
            preset(name)  # raises what is unknown


def run(config: ReportConfig) -> int:
    """Drives everything and writes the report; returns 1 if a row misses."""
    out = Path(config.out)
    require_writable(out / "report.md", new_folders=True)  # refused before the work
    jax.config.update("jax_platforms", "cpu")  # few cars: no work for a GPU
    names = config.presets or sorted(PRESETS)
    studies = [Study(name, preset(name), config.quick) for name in names]
    for study in studies:
        for manoeuvre in SUITE:
            manoeuvre(study)
        print(f"{study.preset}: done", flush=True)
    parts = ["python eval/physics_report.py"]
    parts += ["--presets", *config.presets] * bool(config.presets)
    parts += ["--quick"] * config.quick
    missed = write_report(out, studies, " ".join(parts))
    for row in missed:
        print(f"{row.preset}: {row.row}: {row.verdict}")
    count = sum(len(study.rows) for study in studies)
    print(f"{count} rows, {len(missed)} missed; wrote {config.out}/report.md")
    return 1 if missed else 0


main = command(ReportConfig, run, __doc__)

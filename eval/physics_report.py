"""Runs the validation suite of vehicle dynamics and writes the report.

python eval/physics_report.py
python eval/physics_report.py --presets compact --tyres brush --quick --out runs/physics

Writes `report.md`, `report.csv` and plots. Exit code 1: a row misses its tolerance.
"""

import dataclasses
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import jax
import tyro

from carpark_mj.policy.checkpoints import write_atomically
from carpark_mj.vehicle import PRESETS, VehicleParameters, preset
from vehicle_suite import (
    agreed,
    braking,
    energy,
    handling,
    numerics,
    plots,
    statics,
    turning,
)
from vehicle_suite.contact import ContactTestbed
from vehicle_suite.contact_engines import contact_engines
from vehicle_suite.suspension import suspension
from vehicle_suite.table import Row, Study, markdown, write_csv
from vehicle_suite.testbed import BrushTestbed, Testbed

Tyres = Literal["brush", "contact"]
Manoeuvre = Callable[[Testbed, str, VehicleParameters, bool], Study]

COMMON: tuple[Manoeuvre, ...] = (
    turning.turning,
    braking.stops,
    braking.coast_down,
    braking.load_transfer,
    statics.axle_loads,
    statics.slope_hold,
    statics.slip_threshold,
    energy.balance,
    numerics.mirror,
    handling.lateral_limit,
    statics.scrub_torque,
    numerics.convergence,
)
SUITES: dict[Tyres, tuple[Manoeuvre, ...]] = {
    "brush": (
        *COMMON,
        turning.locked_axle,
        handling.understeer,
        handling.step_steer,
        numerics.engines,
    ),
    "contact": (*COMMON, handling.rolling_turns, contact_engines, suspension),
}
TESTBEDS: dict[Tyres, Callable[[], Testbed]] = {
    "brush": BrushTestbed,
    "contact": ContactTestbed,
}

INTRODUCTION = """# Vehicle physics: measured against formulas

Written by `{command}`; do not edit.

Every expected value follows from the preset's parameters by the formula in its row
(`formulas.py`, `steady_turn.py` and `step_response.py` in `eval/vehicle_suite`). The
test driver sets wheel angles and wheel torques directly: neither pedal nor rate limit
stands between a manoeuvre and the car.

- *brush*: MJX in float32 at 10 ms with the tyres that training uses.
- *contact*: C MuJoCo in float64 at 2 ms with the contact wheels of exported scenes.
  They roll without slip and have no scrub torque. On locked wheels they hop (the steps
  in the plot of stops); the stopping distance is right, momentary loads are not.
  Rows of *suspension* put these wheels on their optional springs.
"""

TOLERANCES = """## Tolerances

Agreed on before the cars were driven, beside the widest that the rows below have;
where that is wider, the physical reason.

{agreed}

Rows without an agreed tolerance:

{unagreed}
"""

ABSENT = """## Rows that a tyre model does not have, and why

{absent}
"""


@dataclasses.dataclass(frozen=True)
class ReportConfig:
    """Settings of `python eval/physics_report.py`.

    Attributes:
        presets: vehicle presets to test; default: all.
        tyres: tyre models to test.
        out: folder of the report.
        quick: run fewer cases, with shorter runs.
    """

    presets: tuple[str, ...] = ()
    tyres: tuple[Tyres, ...] = ("brush", "contact")
    out: str = "docs/physics"
    quick: bool = False


def run(config: ReportConfig) -> Study:
    """Drives every manoeuvre; rows and curves of all cars in one study."""
    everything = Study("", "")
    for tyres in config.tyres:
        bed = TESTBEDS[tyres]()
        for name in config.presets or PRESETS:
            for manoeuvre in SUITES[tyres]:
                study = manoeuvre(bed, name, preset(name), config.quick)
                everything.rows.extend(study.rows)
                everything.curves.extend(study.curves)
            print(f"{name}, {tyres}: done", flush=True)
    return everything


def write_report(folder: Path, study: Study, command: str) -> None:
    """Writes `report.csv`, `report.md` and the plots."""
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "report.csv", study.rows)
    figures = plots.draw(folder, study.curves)
    missed = [row for row in study.rows if not row.passes]
    parts = [INTRODUCTION.format(command=command)]
    parts.append(f"{len(study.rows)} rows, {len(missed)} outside their tolerance.\n")
    if missed:
        parts.append(f"## Outside their tolerance\n\n{markdown(missed)}\n")
    parts.extend(f"![{plots.FIGURES[name][0]}]({name}.png)\n" for name in figures)
    parts.append(
        TOLERANCES.format(
            agreed=agreed.tolerance_table(study.rows),
            unagreed=agreed.unagreed_table(study.rows),
        )
    )
    if absent := agreed.absent_table(study.rows):
        parts.append(ABSENT.format(absent=absent))
    for key in dict.fromkeys((row.preset, row.tyres) for row in study.rows):
        rows = [row for row in study.rows if (row.preset, row.tyres) == key]
        parts.append(f"## {key[0]}, {key[1]} tyres\n\n{markdown(rows)}\n")
    text = "\n".join(parts)
    write_atomically(folder / "report.md", lambda file: file.write_text(text))


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


def main(config: ReportConfig) -> list[Row]:
    """Runs the suite and writes the report; returns the rows that miss.

    Raises:
        ValueError: unknown presets.
        OSError: the folder cannot be written.
    """
    jax.config.update("jax_platforms", "cpu")  # few cars: no work for a GPU
    for name in config.presets:
        preset(name)  # before minutes of driving
    study = run(config)
    write_report(Path(config.out), study, command_of(config))
    missed = [row for row in study.rows if not row.passes]
    for row in missed:
        print(f"{row.preset}, {row.tyres}: {row.row}: {row.verdict}")
    print(f"{len(study.rows)} rows, {len(missed)} missed; wrote {config.out}/report.md")
    return missed


def command_line(argv: Sequence[str]) -> int:
    """Runs the command; returns its exit code."""
    try:
        config = tyro.cli(ReportConfig, args=argv, description=__doc__)
        return 1 if main(config) else 0
    except (ValueError, OSError) as error:
        print(f"physics_report: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(command_line(sys.argv[1:]))

"""The physics report: `report.md`, `report.csv` and plots."""

from pathlib import Path

from carpark_mj.files import write_atomically
from vehicle_suite import agreed, plots
from vehicle_suite.table import Study, markdown, write_csv

SHOWN = "compact"  # the preset whose rows are in the report, if it was driven
INTRODUCTION = """# Vehicle physics: measured against formulas

Written by `{command}`; do not edit.

Every expected value follows from the preset's parameters by the formula in its row
(`formulas.py`, `steady_turn.py` and `step_response.py` in `eval/vehicle_suite`). The
test driver sets wheel angles and wheel torques directly, without pedals and rate
limits. Rows about pedals, the hold, standstill and options (`pedals.py`,
`standstill.py`, `options.py`) use the shipped driver.

- *brush*: MJX in float32 at 10 ms with the tyres that training uses.
- *contact*: C MuJoCo in float64 at 2 ms with the contact wheels of exported scenes.
  They roll without slip and have no scrub torque. On locked wheels they hop (the steps
  in the plot of stops); the stopping distance is right, momentary loads are not.
  Rows of *suspension* put these wheels on their optional springs.
"""

TOLERANCES = """## Tolerances

Agreed on before the cars were driven, beside the largest tolerance of the rows and,
where that is larger, the physical reason.

{agreed}

Rows without an agreed tolerance:

{unagreed}
"""

ABSENT = """## Rows that a tyre model does not have, and why

{absent}
"""


def write_report(folder: Path, study: Study, command: str) -> None:
    """Writes `report.csv`, `report.md` and the plots."""
    folder.mkdir(parents=True, exist_ok=True)
    write_csv(folder / "report.csv", study.rows)
    figures = plots.draw(folder, study.curves)
    missed = [row for row in study.rows if not row.passes]
    parts = [INTRODUCTION.format(command=command)]
    presets = list(dict.fromkeys(row.preset for row in study.rows))
    shown = SHOWN if SHOWN in presets else presets[0]
    parts.append(
        f"{len(study.rows)} rows, {len(missed)} outside their tolerance. "
        f"Below are those of `{shown}`; [report.csv](report.csv) has all.\n"
    )
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
    for tyres in dict.fromkeys(row.tyres for row in study.rows):
        rows = [row for row in study.rows if (row.preset, row.tyres) == (shown, tyres)]
        parts.append(f"## {shown}, {tyres} tyres\n\n{markdown(rows)}\n")
    text = "\n".join(parts)
    write_atomically(folder / "report.md", lambda file: file.write_text(text))

"""Tolerances fixed before the measurements, and reasons for missing rows.

The report sets them against the rows it measured: what a row allows is in the row
alone, and so is its reason where that is more than agreed.
"""

import dataclasses
import re
from collections.abc import Sequence

from vehicle_suite.table import Row

NO_REASON = "no reason given"


@dataclasses.dataclass(frozen=True)
class Agreed:
    """One agreed tolerance.

    Attributes:
        rows: how the names of its rows begin.
        tyres: tyre models it holds for.
        tolerance: in `unit`.
        unit: of the tolerance; "" is a share of the expected value.
    """

    rows: str
    tyres: tuple[str, ...]
    tolerance: float
    unit: str = ""


@dataclasses.dataclass(frozen=True)
class Absent:
    """Why rows exist for one tyre model only.

    Attributes:
        rows: how their names begin.
        tyres: the model that lacks them.
        reason: one sentence.
    """

    rows: tuple[str, ...]
    tyres: str
    reason: str


BOTH = ("brush", "contact")
BRUSH, CONTACT = BOTH[:1], BOTH[1:]

AGREED = (
    Agreed("turning radius", BRUSH, 0.003),
    Agreed("turning radius", CONTACT, 0.0005),
    Agreed("kerb-to-kerb circle", BRUSH, 0.025),
    Agreed("kerb-to-kerb circle", CONTACT, 0.01),
    Agreed("understeer gradient, preset, linear", BRUSH, 0.25),
    Agreed("understeer gradient, preset, brush", BRUSH, 0.05),
    Agreed("understeer gradient, axles at 11:12.5, linear", BRUSH, 0.25),
    Agreed("understeer gradient, axles at 11:12.5, brush", BRUSH, 0.05),
    Agreed("step steer, yaw-rate gain", BOTH, 0.02),
    Agreed("step steer, time to 90 %, 5 m/s", BRUSH, 0.03, "s"),
    Agreed("step steer, time to 90 %, 10 m/s", BRUSH, 0.03, "s"),
    Agreed("stop, locked wheels, 5 m/s", BOTH, 0.01),
    Agreed("stop, 0.3 g, 5 m/s", BOTH, 0.01),
    Agreed("stop, 0.3 g, 2 m/s", BOTH, 0.02),
    Agreed("coast-down deceleration", BOTH, 0.002),
    Agreed("longitudinal load transfer", BOTH, 0.01),
    Agreed("lateral load transfer", BOTH, 0.01),
    Agreed("static front axle load", BOTH, 0.005),
    Agreed("lateral limit", BOTH, 0.035, "mu g"),
    Agreed("creep on a", BRUSH, 1e-5, "m/s"),
    Agreed("creep on a 5 % slope", CONTACT, 1e-4, "m/s"),
    Agreed("slip threshold", BOTH, 0.5, "deg"),
    Agreed("energy balance, accelerating", BRUSH, 1e-3, "of the work"),
    Agreed("energy balance, accelerating", CONTACT, 5e-4, "of the work"),
    Agreed("scrub torque", BRUSH, 0.05),
    Agreed("mirror symmetry", BOTH, 1e-6, "m"),
    Agreed("time-step error, 10 ms", BRUSH, 0.5, "% of the path"),
    Agreed("C MuJoCo against MJX", BOTH, 1e-5, "m"),
)

ABSENT = (
    Absent(
        ("unrolled step against mjx.step",),
        "contact",
        "Contact wheels need MuJoCo's solver: there is no unrolled step.",
    ),
    Absent(
        ("drag, locked axle", "radius, locked axle"),
        "contact",
        "One wheel of a rigid coupled pair always slides whole, with mu F_z whatever "
        "its slip: no slip stiffness to expect a force from.",
    ),
    Absent(
        (
            "understeer gradient, preset, linear",
            "understeer gradient, preset, brush",
            "understeer gradient, axles",
        ),
        "contact",
        "Coulomb contacts have no cornering stiffness; that their gradient is none is "
        "measured instead (`rolling`).",
    ),
    Absent(
        ("understeer gradient, preset, rolling",),
        "brush",
        "A brush slips under any side force.",
    ),
    Absent(
        ("step steer, time to 90 %",),
        "contact",
        "Without slip angles the yaw rate follows the wheels' angle at once: nothing "
        "takes time to rise.",
    ),
    Absent(
        ("time-step error, 10 ms", "time-step error, 5 ms", "time-step order, 10"),
        "contact",
        "At more than 4 ms a locked contact wheel throws the car: longer steps are "
        "refused.",
    ),
    Absent(
        ("time-step error, 4 ms", "time-step order, 4"),
        "brush",
        "4 ms is the longest step of contact wheels; brush tyres are driven from 10 ms "
        "down.",
    ),
    Absent(
        ("suspension: ",),
        "brush",
        "The vertical force of a brush tyre has spring and damper in it; load transfer "
        "and step steer show them.",
    ),
    Absent(
        (
            "pedals against the motion",
            "held on a",
            "creep against the drive",
            "braking beyond the pedal",
            "coasting after a start",
            "stop from a walk",
            "speed control at",
            "time-step error, 10 against 1 ms",
            "steering 0.24 s and pedal 0.1 s late",
            "steering late",
            "automatic creeping",
            "odometry, ",
            "wheel stop",
            "ramp of",
        ),
        "contact",
        "The driver's law is the same on any tyres; it is driven on those of training.",
    ),
    Absent(
        ("data of a shared model",),
        "brush",
        "A car on brush tyres has no constraint whose softness could be another car's.",
    ),
)


def tolerance_table(rows: Sequence[Row]) -> str:
    """The agreed tolerances beside the widest that the rows have, as markdown."""
    lines = ["| rows | tyres | agreed | here, at most | |", "|---|---|---|---|---|"]
    for agreed in AGREED:
        for tyres in agreed.tyres:
            own = [
                r for r in rows if r.tyres == tyres and r.row.startswith(agreed.rows)
            ]
            if not own:
                continue
            widths = [_width(row, agreed.unit) for row in own]
            limit = 1.001 * agreed.tolerance  # rounding
            whys = {r.why for r, w in zip(own, widths, strict=True) if w > limit}
            if whys:
                verdict = "wider: " + "; ".join(sorted(w or NO_REASON for w in whys))
            else:
                verdict = (
                    "tighter" if max(widths) < 0.999 * agreed.tolerance else "same"
                )
            cells = (
                _text(agreed.tolerance, agreed.unit),
                _text(max(widths), agreed.unit),
            )
            lines.append(
                f"| {agreed.rows} | {tyres} | {cells[0]} | {cells[1]} | {verdict} |"
            )
    return "\n".join(lines)


def unagreed_table(rows: Sequence[Row]) -> str:
    """Rows without an agreed tolerance, with the one they have."""
    lines = ["| rows | tyres | here, at most |", "|---|---|---|"]
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        names = [a.rows for a in AGREED if row.tyres in a.tyres]
        if not any(row.row.startswith(name) for name in names):
            name = re.sub(r", [\d.]+ deg", "", row.row)  # each car has its own
            groups.setdefault((name, row.tyres), []).append(row)
    for (name, tyres), own in groups.items():
        share = all(0 < row.tolerance < abs(row.expected) for row in own)
        unit = "" if share else own[0].unit
        widest = max(_width(row, unit) for row in own)
        lines.append(f"| {name} | {tyres} | {_text(widest, unit)} |")
    return "\n".join(lines)


def absent_table(rows: Sequence[Row]) -> str:
    """Rows of one tyre model only, with the reason; none if one model was driven."""
    names = {tyres: {r.row for r in rows if r.tyres == tyres} for tyres in BOTH}
    lines = ["| rows | not on | why |", "|---|---|---|"]
    if not all(names.values()):
        return ""
    for tyres, other in (BOTH, BOTH[::-1]):
        groups: dict[str, list[str]] = {}
        for name in sorted(names[other] - names[tyres]):
            found = [
                (start, absent.reason)
                for absent in ABSENT
                for start in absent.rows
                if absent.tyres == tyres and name.startswith(start)
            ]
            start, reason = found[0] if found else (name, NO_REASON)
            if start not in groups.setdefault(reason, []):
                groups[reason].append(start)
        lines += [
            f"| {'; '.join(name.strip(': ') for name in starts)} | {tyres} | {reason} |"
            for reason, starts in groups.items()
        ]
    return "\n".join(lines)


def _width(row: Row, unit: str) -> float:
    """A row's tolerance in a unit, "" for a share of its expected value."""
    if unit:
        return row.tolerance if row.unit == unit else float("inf")
    return row.tolerance / abs(row.expected) if row.expected else float("inf")


def _text(tolerance: float, unit: str) -> str:
    if unit:
        return f"{tolerance:.3g} {unit}"
    return f"{100 * tolerance:.3g} %" if tolerance < 10 else "absolute"

"""Agreed tolerances and absent rows: the report says what its rows say."""

import csv
from pathlib import Path

from vehicle_suite import agreed
from vehicle_suite.table import Row

DOCS = Path(__file__).parents[2] / "docs" / "physics"


def row(name: str, tyres: str, expected: float, tolerance: float, unit="m", why=""):
    return Row(name, "car", tyres, "", unit, expected, expected, tolerance, why)


def cells(table: str) -> list[list[str]]:
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table.splitlines()[2:]
    ]


def test_the_widest_row_is_set_against_what_was_agreed():
    rows = [
        row("coast-down deceleration", "brush", 0.1, 0.0001),
        row("coast-down deceleration", "brush", 0.2, 0.0004),  # 0.2 % as agreed
        row("coast-down deceleration", "contact", 0.1, 0.0001),
        row("turning radius, 10 deg", "contact", 5.0, 0.05, why="soft"),  # 1 %
        row("slip threshold", "brush", 42.0, 0.6, "deg"),
    ]
    assert cells(agreed.tolerance_table(rows)) == [
        ["turning radius", "contact", "0.05 %", "1 %", "wider: soft"],
        ["coast-down deceleration", "brush", "0.2 %", "0.2 %", "same"],
        ["coast-down deceleration", "contact", "0.2 %", "0.1 %", "tighter"],
        ["slip threshold", "brush", "0.5 deg", "0.6 deg", "wider: no reason given"],
    ]


def test_an_absolute_tolerance_is_wider_than_any_share_of_zero():
    name = "understeer gradient, preset, linear"
    table = agreed.tolerance_table([row(name, "brush", 0.0, 0.1, "deg/g", "neutral")])
    assert cells(table) == [[name, "brush", "25 %", "absolute", "wider: neutral"]]


def test_a_tolerance_in_another_unit_is_not_taken_for_the_same():
    table = agreed.tolerance_table([row("mirror symmetry", "brush", 0.0, 1e-9, "mm")])
    assert cells(table)[0][-1] == "wider: no reason given"


def test_rows_nobody_agreed_on_are_listed_over_all_cars():
    rows = [
        row("drag, locked axle, 10.6 deg, 1 m/s", "brush", 300.0, 3.0),
        row("drag, locked axle, 9.9 deg, 1 m/s", "brush", 300.0, 6.0),
        row("mirror symmetry, 6 s", "brush", 0.0, 1e-6),
    ]
    table = agreed.unagreed_table(rows)
    assert cells(table) == [["drag, locked axle, 1 m/s", "brush", "2 %"]]


def test_rows_of_one_model_only_come_with_a_reason():
    rows = [
        row("mirror symmetry, 6 s", "brush", 0.0, 1e-6),
        row("step steer, time to 90 %, 5 m/s", "brush", 0.1, 0.03),
        row("mirror symmetry, 6 s", "contact", 0.0, 1e-6),
        row("wobble", "contact", 0.0, 1.0),
    ]
    (one, other) = cells(agreed.absent_table(rows))
    assert one == ["wobble", "brush", "no reason given"]
    assert other[:2] == ["step steer, time to 90 %", "contact"]
    assert "Without slip angles" in other[2]
    assert agreed.absent_table(rows[:2]) == ""  # nothing to compare with


def test_the_committed_report_gives_every_reason_and_uses_every_entry():
    text = (DOCS / "report.md").read_text()
    assert "## Tolerances" in text
    assert "## Rows that a tyre model does not have, and why" in text
    assert agreed.NO_REASON not in text
    with (DOCS / "report.csv").open(newline="") as file:
        seen = {(r["row"], r["tyres"]) for r in csv.DictReader(file)}
    for entry in agreed.AGREED:
        for tyres in entry.tyres:
            assert any(t == tyres and n.startswith(entry.rows) for n, t in seen), entry
    for entry in agreed.ABSENT:
        for start in entry.rows:
            assert {t for n, t in seen if n.startswith(start)} == (
                {"brush", "contact"} - {entry.tyres}
            ), start

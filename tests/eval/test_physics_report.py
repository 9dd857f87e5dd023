"""The physics report: formulas against hand-worked cases, rows, files, exit code."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.programs import rows_of

import physics_report
from carpark_mj.vehicle import COMPACT
from vehicle_suite import formulas
from vehicle_suite.report import Row, Study, declared, lines
from vehicle_suite.testbed import Run, circle_radius, ramp

# Round numbers for sums by hand.
PLAIN = dataclasses.replace(
    COMPACT,
    wheelbase=2.5,
    track_width=1.5,
    mass=1000.0,
    cg_to_front_axle=1.0,
    cg_height=0.5,
    wheel_radius=0.3,
    wheel_inertia=0.9,
    front_drive=1.0,
)


# Formulas


def test_load_transfers_by_hand():
    # (1000 x 0.5 + 4 x 0.9 / 0.3) kg m x 2 m/s^2 = 1024 N m over track or wheelbase.
    # 4905 N m/rad of leaning weight against springs of 63 000 N m/rad.
    rolling = formulas.lateral_load_transfer(PLAIN, 2.0)
    assert rolling == pytest.approx(1024 / 1.5 / (1 - 4905 / 63_000))
    pitching = formulas.longitudinal_load_transfer(PLAIN, 2.0)
    plain = 1024 / 2.5 / (1 - 4905 / 175_000)
    lower = 0.25 * plain / 70_000  # m, of a mass 0.25 m ahead of the middle
    assert pitching == pytest.approx(plain - 1000 * lower * 2.0 / 2.5)


def test_the_brush_curve_by_hand():
    # s = 1.5: s - s^2/3 + s^3/27 = 0.875.
    assert 1.5 * formulas.brush_shape(1500.0, 1000.0) == pytest.approx(0.875)
    assert -1.5 * formulas.brush_shape(-1500.0, 1000.0) == pytest.approx(-0.875)
    assert 9.0 * formulas.brush_shape(9000.0, 1000.0) == pytest.approx(1.0)


# Signals and tracks


def test_signals_act_when_they_should():
    table = Run(COMPACT, 1.0, force=ramp(100.0, 0.0, 0.5)).signals(0.1)
    assert table[:, 1] == pytest.approx([0, 20, 40, 60, 80, 100, 100, 100, 100, 100])
    assert not table[:, 4].any()  # no speed is held


def test_circles():
    angle = np.linspace(0.0, 1.0, 20)
    arc = np.stack([100 + 4 * np.cos(angle), 4 * np.sin(angle) - 50], -1)
    assert circle_radius(arc) == pytest.approx(4.0, rel=1e-9)


# Table, files, command


def test_verdicts():
    texts = "row", "compact", "a, b"
    good = Row(*texts, "m", 1.004, 1.0, 0.01, "reason")
    bad = Row(*texts, "deg", 3.0, 0.0, 0.5)
    assert (good.passes, good.verdict) == (True, "pass: +0.4 % of ±1 %; reason")
    assert (bad.passes, bad.verdict) == (False, "MISS: +3 of ±0.5 deg")
    assert not dataclasses.replace(good, measured=math.nan).passes


def test_the_rows_declared_are_those_of_the_report():
    report = Path(__file__).parents[2] / "docs" / "physics" / "report.csv"
    used = []
    for row in rows_of(report):
        fact = declared(row["row"])
        assert (fact["formula"], fact["unit"]) == (row["formula"], row["unit"])
        used.append(fact)
    assert [fact for fact in lines() if fact not in used] == []
    with pytest.raises(ValueError, match="no 'top speed'"):
        declared("top speed")


@pytest.mark.parametrize(("measured", "code"), [(0.0, 0), (0.5, 1)])
def test_a_missed_row_makes_exit_code_1(measured, code, tmp_path, monkeypatch, capsys):
    def manoeuvre(study: Study) -> None:
        study.row("creep on a 20 % slope, 60 s", measured)

    monkeypatch.setattr(physics_report, "SUITE", (manoeuvre,))
    flags = ["--presets", "compact"]
    assert physics_report.main([*flags, "--out", str(tmp_path)]) == code
    printed = capsys.readouterr().out
    assert ("creep on a 20 % slope, 60 s: MISS" in printed) == bool(code)
    assert f"1 rows, {code} missed" in printed
    report = (tmp_path / "report.md").read_text()
    assert ("Outside their tolerance" in report) == bool(code)
    assert f"`python eval/physics_report.py {' '.join(flags)}`" in report

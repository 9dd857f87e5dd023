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
from vehicle_suite.report import Row, Study, declared, lines_of
from vehicle_suite.testbeds import Run, circle_radius, crossing, ramp, step

# Round numbers for sums by hand.
PLAIN = dataclasses.replace(
    COMPACT,
    wheelbase=2.5,
    track_width=1.5,
    mass=1000.0,
    cg_to_front_axle=1.0,
    cg_height=0.5,
    wheel_radius=0.3,
    tyre_width=0.2,
    wheel_inertia=0.9,
    front_drive=1.0,
)


# Formulas


def test_load_transfers_by_hand():
    # (1000 x 0.5 + 4 x 0.9 / 0.3) kg m x 2 m/s^2 = 1024 N m over track or wheelbase.
    rigid = formulas.lateral_load_transfer(PLAIN, 2.0, "rigid")
    assert rigid == pytest.approx(1024 / 1.5)
    # 4905 N m/rad of leaning weight against springs of 63 000 N m/rad.
    soft = formulas.lateral_load_transfer(PLAIN, 2.0)
    assert soft == pytest.approx(1024 / 1.5 / (1 - 4905 / 63_000))
    rigid = formulas.longitudinal_load_transfer(PLAIN, 2.0, "rigid")
    assert rigid == pytest.approx(1024 / 2.5)
    pitching = formulas.longitudinal_load_transfer(PLAIN, 2.0)
    plain = 1024 / 2.5 / (1 - 4905 / 175_000)
    lower = 0.25 * plain / 70_000  # m, of a mass 0.25 m ahead of the middle
    assert pitching == pytest.approx(plain - 1000 * lower * 2.0 / 2.5)
    # Over hubs 0.3 m high only 0.2 m of the height leans: 1962 N m/rad.
    hubs = formulas.lateral_load_transfer(PLAIN, 2.0, "hubs")
    assert hubs == pytest.approx(1024 / 1.5 / (1 - 1962 / 63_000))
    # A side's two springs of 28 kN/m move by a roll of 1 % times 0.75 m.
    assert formulas.tilt_angle(PLAIN, 2 * 28_000 * 0.0075, 1.5) == pytest.approx(0.01)


def test_kerb_circle_of_the_compact_is_the_published_one():
    # 10.9 m kerb to kerb, published for the Golf VII.
    assert formulas.kerb_circle(COMPACT) == pytest.approx(10.9, abs=0.02)


def test_the_brush_curve_by_hand():
    # s = 1.5: s - s^2/3 + s^3/27 = 0.875.
    assert 1.5 * formulas.brush_shape(1500.0, 1000.0) == pytest.approx(0.875)
    assert -1.5 * formulas.brush_shape(-1500.0, 1000.0) == pytest.approx(-0.875)
    assert 9.0 * formulas.brush_shape(9000.0, 1000.0) == pytest.approx(1.0)


def test_the_step_response_settles_at_the_neutral_gain():
    time = np.arange(0.0, 4.0, 0.001)
    response = formulas.step_response(PLAIN, 10.0, time)
    assert response[0] == 0.0
    assert response[-1] == pytest.approx(10.0 / 2.5, rel=1e-3)  # v / L, as K = 0


# Signals and tracks


def test_signals_act_when_they_should():
    run = Run(COMPACT, 1.0, steering=step(0.2, 0.5), force=ramp(100.0, 0.0, 0.5))
    table = run.signals(0.1)
    assert table[:, 0].tolist() == [0.0] * 5 + [0.2] * 5
    assert table[:, 1] == pytest.approx([0, 20, 40, 60, 80, 100, 100, 100, 100, 100])
    assert not table[:, 4].any()  # no speed is held


def test_crossings_and_circles():
    x = np.array([0.0, 1.0, 2.0, 3.0])
    assert crossing(x, x**2, 2.5) == pytest.approx(1.5)
    assert math.isnan(crossing(x, x, 4.0))
    angle = np.linspace(0.0, 1.0, 20)
    arc = np.stack([100 + 4 * np.cos(angle), 4 * np.sin(angle) - 50], -1)
    assert circle_radius(arc) == pytest.approx(4.0, rel=1e-9)


# Table, files, command


def test_verdicts():
    texts = "row", "compact", "brush", "a, b"
    good = Row(*texts, "m", 1.004, 1.0, 0.01, "reason")
    bad = Row(*texts, "deg", 3.0, 0.0, 0.5)
    assert (good.passes, good.verdict) == (True, "pass: +0.4 % of ±1 %; reason")
    assert (bad.passes, bad.verdict) == (False, "MISS: +3 of ±0.5 deg")
    assert not dataclasses.replace(good, measured=math.nan).passes


def test_the_rows_declared_are_those_of_the_report():
    report = Path(__file__).parents[2] / "docs" / "physics" / "report.csv"
    used = []
    for row in rows_of(report):
        fact = declared(row["row"], row["tyres"])
        assert (fact["formula"], fact["unit"]) == (row["formula"], row["unit"])
        used.append(fact)
    assert [fact for fact in lines_of("rows.csv") if fact not in used] == []
    with pytest.raises(ValueError, match="no 'top speed' on brush"):
        declared("top speed", "brush")


@pytest.mark.parametrize(("measured", "code"), [(0.0, 0), (0.5, 1)])
def test_a_missed_row_makes_exit_code_1(measured, code, tmp_path, monkeypatch, capsys):
    def manoeuvre(study: Study) -> None:
        study.row("mirror symmetry, 6 s", measured)
        study.curve("stops", "line", [0.0, 1.0], [1.0, 0.0])

    monkeypatch.setattr(physics_report, "SUITES", {"brush": (manoeuvre,)})
    flags = ["--presets", "compact", "--tyres", "brush"]
    assert physics_report.main([*flags, "--out", str(tmp_path)]) == code
    printed = capsys.readouterr().out
    assert ("mirror symmetry, 6 s: MISS" in printed) == bool(code)
    assert f"1 rows, {code} missed" in printed
    report = (tmp_path / "report.md").read_text()
    assert ("Outside their tolerance" in report) == bool(code)
    assert f"`python eval/physics_report.py {' '.join(flags)}`" in report
    assert (tmp_path / "stops.png").read_bytes().startswith(b"\x89PNG")

"""Cars from logs: parameters of C MuJoCo's cars come back, with honest intervals."""

import csv
import dataclasses
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.programs import assert_refused
from helpers.programs import identify as main

from carpark_mj.cli import vehicles as command
from carpark_mj.identification.fit import PARAMETERS, identify
from carpark_mj.identification.log import read_log
from carpark_mj.identification.simulation import Replay, Sought
from carpark_mj.vehicle import COMPACT, preset
from vehicle_suite.logs import Drive, record

TRUE = Sought(0.12, 0.2, 16.0, 0.015, 9.0, 1.7, 3.4, 0.015, 0.1, 0.4, 0.07)
SECONDS, SIM_DT = 21.0, 0.01
# A car whose drive and brakes push along its axis and not along its steered wheels.
ALONG = {"front_drive": 0.0, "front_brake": 0.0}
OTHERS = {"gear": 1, "remark": "none"}


@pytest.fixture(scope="module")
def logs():
    """Logs of C MuJoCo by what the driver does."""
    return {
        kind: record(Drive(TRUE, COMPACT, kind, 5, SECONDS, SIM_DT))
        for kind in ("full", "circle")
    }


def rows_of(log, **units):
    """Rows of a log's file; columns in other units by name and unit."""
    columns = {
        "time": log.time,
        **dict(zip(log.names, (log.steering, log.pedal), strict=True)),
        **log.measured,
    }
    for name, (column, unit) in units.items():
        columns[column] = columns.pop(name) / unit
    return [
        {**dict(zip(columns, map(float, row), strict=True)), **OTHERS}
        for row in zip(*columns.values(), strict=True)
    ]


def write(path, rows):
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [*rows[0]])
        table.writeheader()
        table.writerows(rows)
    return str(path)


def read_log_of(tmp_path, rows):
    return read_log(Path(write(tmp_path / "log.csv", rows)))


def test_all_parameters_come_back_with_intervals_that_cover_them(logs):
    found = identify(logs["full"], COMPACT, 0.0, SIM_DT)
    unknown = "lateral_relaxation", "patch_radius"
    for name, estimate in found.estimates.items():
        assert estimate.identifiable or name in unknown, name
        if estimate.identifiable:  # twice half an interval: four standard deviations
            assert abs(estimate.value - getattr(TRUE, name)) < 2 * estimate.error, name
        assert estimate.error > 0
    # The residuals are the noise of the sensors.
    assert found.residuals["x"] == pytest.approx(0.02, rel=0.1)
    assert found.residuals["yaw"] == pytest.approx(0.003, rel=0.1)


@pytest.mark.parametrize(("kind", "car"), [("stops", {}), ("rolling", ALONG)])
def test_intervals_cover_a_car_of_other_equations(kind, car):
    true = Sought(0.08, 0.18, 15.4, 0.01, 10.0, 1.7, 3.5, 0.015, 0.12, 0.4, 0.0)
    log = record(Drive(true, dataclasses.replace(COMPACT, **car), kind, 1, 30.0))
    estimates = identify(log, COMPACT, 0.0, SIM_DT).estimates
    told = {name: e for name, e in estimates.items() if e.identifiable}
    assert {"pedal_delay", "steering_ratio", "rolling_resistance"} <= {*told}
    missed = [n for n, e in told.items() if abs(e.value - getattr(true, n)) > e.error]
    assert len(missed) <= 1, missed  # of about eight, at 95 %


def test_what_a_log_does_not_tell_keeps_its_value(logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command.fitting, "identify", partial(identify, sim_dt=SIM_DT))
    path = write(tmp_path / "log.csv", rows_of(logs["circle"]))
    out = tmp_path / "my_car.yaml"
    assert main([path, "--vehicle", "compact", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "ignored columns: gear, remark" in told
    for name in ("steering_delay", "steering_ratio", "steering_offset"):
        assert f"{name} keeps the vehicle's value" in told
        assert PARAMETERS[name].needs in told
    car = preset(str(out))
    assert car.max_acceleration == pytest.approx(1.7, rel=0.02)
    assert car.max_deceleration == pytest.approx(3.4, rel=0.05)
    kept = {name: getattr(car, name) for name in ("length", "mass", "steering_rate")}
    assert kept == {name: getattr(COMPACT, name) for name in kept}


def test_units_are_by_the_column_s_name(logs, tmp_path):
    units = {
        "time": ("time_ms", 1e-3),
        "steering_wheel": ("steering_wheel_deg", math.pi / 180),
        "yaw": ("yaw_deg", math.pi / 180),
    }
    log = logs["full"]
    read = read_log_of(tmp_path, rows_of(log, **units))
    assert np.allclose(read.time, log.time)
    assert np.allclose(read.steering, log.steering)
    assert np.allclose(read.measured["yaw"], log.measured["yaw"])
    assert np.allclose(read.speed, log.speed)


def test_headings_may_wrap_and_measurements_may_be_missing(logs, tmp_path):
    log, rows = logs["circle"], rows_of(logs["circle"])
    for k, row in enumerate(rows):
        row["yaw"] = math.remainder(row["yaw"], 2 * math.pi)
        if k % 5:
            row["x"] = row["y"] = row["yaw"] = ""
    read = read_log_of(tmp_path, rows)
    turns = read.measured["yaw"][::5] - log.measured["yaw"][::5]
    assert np.allclose(turns, turns[0])
    assert np.isnan(read.measured["x"]).mean() == pytest.approx(0.8, abs=0.01)


def test_an_acceleration_is_the_pedal_that_asks_for_it(logs, tmp_path):
    rows = rows_of(logs["full"])
    speed = logs["full"].speed
    for row, v in zip(rows, speed, strict=True):
        pedal = row.pop("pedal")
        full = COMPACT.max_deceleration if pedal * v < 0 else COMPACT.max_acceleration
        row["acceleration"] = pedal * full
    by_pedal, by_acceleration = (
        Replay(log, COMPACT, 0.0).recording
        for log in (logs["full"], read_log_of(tmp_path, rows))
    )
    assert np.allclose(by_pedal.pedal, by_acceleration.pedal)


def without(*names):
    return lambda rows: [
        {k: v for k, v in row.items() if k not in names} for row in rows
    ]


def with_value(name, value, at=slice(None)):
    def change(rows):
        for row in rows[at]:
            row[name] = value
        return rows

    return change


REFUSED = {
    "no pedal": (without("pedal"), "lacks the columns pedal or acceleration"),
    "two units": (with_value("time_ms", 1), "time and time_ms: leave one"),
    "nan": (with_value("pedal", "nan", slice(9, 10)), "line 11: pedal must be finite"),
    "a pedal in percent": (with_value("pedal", 60.0), "pedal must lie within ±1"),
    "time that stands": (with_value("time", 3.0, slice(9, 11)), "time must increase"),
    "too short": (lambda rows: rows[:300], "must last 10 to 300 s, not 5.98"),
    "a gap": (lambda rows: rows[:300] + rows[400:], "at most 0.25 s apart, not 2.02"),
    "a jump": (with_value("x", 1e300, slice(500, 501)), "to 60 m/s, not "),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_is_no_log_is_refused_in_one_sentence(logs, tmp_path, capsys, fault):
    change, told = REFUSED[fault]
    path = write(tmp_path / "log.csv", change(rows_of(logs["full"])))
    words = [path, "--vehicle", "compact"]
    assert path in assert_refused(capsys, "identify", words, told)

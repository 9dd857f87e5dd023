"""The manoeuvres of the physics report: every row of the compact car, and some more."""

import dataclasses

import numpy as np
import pytest

import physics_report
from carpark_mj.config import SimConfig
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle, preset
from vehicle_suite import engines, manoeuvres
from vehicle_suite.report import Study
from vehicle_suite.shipped import drive
from vehicle_suite.testbeds import BrushTestbed, Run


@pytest.fixture(scope="module")
def bed() -> BrushTestbed:
    return BrushTestbed()


def check(manoeuvre, bed, params=COMPACT, quick=True) -> Study:
    study = Study(bed, "car", params, quick)
    manoeuvre(study)
    assert study.rows
    missed = [f"{row.row}: {row.verdict}" for row in study.rows if not row.passes]
    assert missed == []
    return study


ELSEWHERE = engines.taps, engines.brush_engines  # of every preset, or of other cars
COSTLY = manoeuvres.turning, manoeuvres.slope_hold
COSTLY += engines.mirror, engines.convergence, engines.reversing  # in float64
COSTLY += (engines.wheel_stop,)


def case(tyres: str, manoeuvre):
    marks = [pytest.mark.slow] if manoeuvre in COSTLY else []
    return pytest.param(
        tyres, manoeuvre, id=f"{tyres}-{manoeuvre.__name__}", marks=marks
    )


@pytest.mark.parametrize(
    ("tyres", "manoeuvre"),
    [
        case(tyres, manoeuvre)
        for tyres, suite in physics_report.SUITES.items()
        for manoeuvre in suite
        if manoeuvre not in ELSEWHERE
    ],
)
def test_the_compact_passes(tyres, manoeuvre):
    check(manoeuvre, physics_report.TESTBEDS[tyres]())


# Differs from the car that MJX compiles in everything that a batch may mix.
VAN = PRESETS["van"]
UNLIKE = dataclasses.replace(
    VAN,
    track_width=1.7,
    width=1.95,
    wheel_radius=0.35,
    wheel_mass=28.0,
    wheel_inertia=1.8,
    wheel_tilt_inertia=1.0,
    knuckle_mass=14.0,
    ackermann=0.6,
    tyre=dataclasses.replace(VAN.tyre, friction=0.7),
)


@pytest.mark.parametrize("car", [COMPACT, UNLIKE], ids=["compact", "van"])
def test_a_second_of_driving_agrees_with_c_mujoco_and_mjx(car, bed):
    study = check(engines.brush_engines, bed, car, quick=False)
    assert len(study.rows) == 4  # in float32 and float64
    assert max(row.measured for row in study.rows) < 5e-6  # measured up to 1e-6
    path = engines.drive_in_c(car, SimConfig(ctrl_dt=0.02, trace_dt=0.02))
    assert np.linalg.norm(path[-1]) > 1.0  # m


@pytest.mark.parametrize("name", PRESETS)
def test_a_tap_on_the_pedal_ends_without_rocking(name, bed):
    check(engines.taps, bed, preset(name))


def test_contact_wheels_in_mjx_stop_by_the_formula_and_stay():
    sim = SimConfig(sim_dt=0.004, ctrl_dt=0.02, trace_dt=0.02, tyres="contact")
    pedals = np.repeat([1.0, -1.0, 0.0], [100, 34, 116])  # 2 s, 0.68 s and 2.32 s
    controls = np.stack([0.0 * pedals, pedals], axis=-1)
    motion = drive(sim, make_vehicle(COMPACT), controls).motion
    top, way = motion.speed[99], motion.pose_w[-1, 0] - motion.pose_w[99, 0]
    assert top > 2.5
    assert way == pytest.approx(top**2 / (2 * COMPACT.max_deceleration), rel=0.08)
    assert motion.speed.min() > -0.05  # not thrown backwards
    assert abs(motion.speed[-1]) < 1e-3
    rest = motion.pose_w[-50:]
    assert np.abs(rest - rest[-1]).max() < 1e-4


def test_a_tall_soft_car_slides_before_it_tips_over(bed):
    # Its static threshold is (T / 2h - lean) g = 1.0 g, above mu g = 0.9 g. With forces
    # at patches that lean into the ground with the car it fell over.
    tyre = dataclasses.replace(COMPACT.tyre, vertical_stiffness=25_000.0)
    car = dataclasses.replace(COMPACT, cg_height=0.65, height=1.7, tyre=tyre)
    check(manoeuvres.lateral_limit, bed, car)


def test_runs_of_one_batch_do_not_touch_each_other(bed):
    runs = [Run(COMPACT, t, speed=v) for t, v in ((0.5, 1.0), (1.0, 2.0), (0.7, 3.0))]
    together = bed.drive(runs)
    for run, track in zip(runs, together, strict=True):
        assert len(track.qpos) == round(run.duration / bed.dt) + 1
        assert track.speed[0] == pytest.approx(run.speed)
        assert np.array_equal(bed.drive([run])[0].qpos, track.qpos)

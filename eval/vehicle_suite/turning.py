"""Slow turns: radius, kerb-to-kerb circle, drag, open differential and locked axle."""

import dataclasses
import itertools
import math

import numpy as np

from carpark_mj.vehicle.parameters import VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.runs import Run, ramp
from vehicle_suite.steady_turn import Turn, steady_turn
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed
from vehicle_suite.tracks import Track, circle_radius

LOCKS = (0.3, 0.6, 0.85, 1.0)  # of full lock
SPEEDS = (0.5, 1.0, 3.0, -1.0)  # m/s
STEADY = 1.0  # s at the end of a run over which steady values are averaged

# Share of the radius. Brush: measured up to 0.005 % at 1 m/s, 0.02 % at 3 m/s. Contact:
# geometry has no slip, and regularised friction slips with the speed.
SHARES = {"brush": {1.0: 0.0005, 3.0: 0.001}, "contact": {1.0: 0.0005, 3.0: 0.0005}}


def expected_turn(
    bed: Testbed, params: VehicleParameters, steering: float, speed: float
) -> Turn:
    """Expected turn of the tyre model: slip and scrub, or geometry alone."""
    if bed.tyres == "brush":
        return steady_turn(params, steering, speed)
    radius = formulas.turning_radius(params, steering)
    return Turn(radius, formulas.rolling_drag(params, steering))


def turn_run(
    params: VehicleParameters, lock: float, speed: float, locked_axle: bool = False
) -> Run:
    """Wheels to the lock [rad], then a circle at a speed [m/s]."""
    return Run(
        params,
        8.0 + 10.0 / abs(speed),
        target=ramp(speed, 1.0, 2.0),
        steering=ramp(lock, 0.0, 1.0),
        locked_axle=locked_axle,
    )


def turning(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """Radius over steering angle and speed, kerb circle and drag at full lock."""
    study = Study(name, bed.tyres)
    speeds = (1.0, -1.0) if quick else SPEEDS
    locks = [f * params.max_steering for f in (LOCKS[-1:] if quick else LOCKS)]
    cases = list(itertools.product(speeds, locks))
    tracks = bed.drive([turn_run(params, lock, speed) for speed, lock in cases])
    formula = "R = L / tan(delta)"
    if bed.tyres == "brush":
        formula += " + slip and scrub of the two-track car"
    for (speed, lock), track in zip(cases, tracks, strict=True):
        radius = circle_radius(track.position[track.at(7.0) :])
        expected = expected_turn(bed, params, lock, track.late(track.speed, STEADY))
        angle, way = math.degrees(lock), "forwards" if speed > 0 else "reverse"
        share = SHARES[bed.tyres][3.0 if speed > 1 else 1.0]
        study.row(
            f"turning radius, {angle:.1f} deg, {abs(speed):g} m/s {way}",
            formula,
            "m",
            radius,
            expected.radius,
            relative(expected.radius, share),
        )
        if lock == params.max_steering and speed == 1.0:
            _kerb_circle(study, track)
            _drag(study, bed, track, expected)
    return study


def _kerb_circle(study: Study, track: Track) -> None:
    """The circle of the outer front tyre against geometry and the maker's figure."""
    params = track.params
    late = slice(track.at(7.0), None)
    cos, sin = np.cos(track.yaw[late]), np.sin(track.yaw[late])
    x, y = params.wheelbase, -params.track_width / 2
    hub = track.position[late] + np.stack([x * cos - y * sin, x * sin + y * cos], -1)
    measured = 2 * circle_radius(hub) + params.tyre_width
    geometric = formulas.kerb_circle(params)
    brush = study.tyres == "brush"
    study.row(
        "kerb-to-kerb circle, geometry",
        "D = 2 (L / sin(delta_o) + w / 2)",
        "m",
        measured,
        geometric,
        (
            relative(geometric, 0.015 if brush else 0.001),
            "scrub and slip widen it" if brush else "",
        ),
    )
    study.row(
        "kerb-to-kerb circle, published",
        "the maker's figure",
        "m",
        measured,
        params.turning_circle,
        (
            relative(params.turning_circle, 0.025 if brush else 0.01),
            "scrub and slip widen it" if brush else "",
        ),
    )


def _drag(study: Study, bed: Testbed, track: Track, expected: Turn) -> None:
    study.row(
        "drag at full lock, open differential, 1 m/s",
        "balance of the two-track car"
        if bed.tyres == "brush"
        else "sum c_rr F_i v_i / v_driven",
        "N",
        track.late(track.drive.sum(1), STEADY) / track.params.wheel_radius,
        expected.drag,
        relative(expected.drag, 0.01),
    )


def locked_axle(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Radius and drag with the driven wheels coupled, against the same formulas.

    A car with all-wheel drive is driven by its front axle here.
    """
    del quick
    study = Study(name, bed.tyres)
    params = dataclasses.replace(params, front_drive=round(params.front_drive + 0.01))
    lock = LOCKS[0] * params.max_steering
    (track,) = bed.drive([turn_run(params, lock, 1.0, locked_axle=True)])
    expected = steady_turn(params, lock, track.late(track.speed, STEADY), locked=True)
    what = f"locked axle, {math.degrees(lock):.1f} deg, 1 m/s"
    formula = "two-track car, driven wheels at one speed, combined slip"
    drag = track.late(track.drive.sum(1), STEADY) / params.wheel_radius
    radius = circle_radius(track.position[track.at(10.0) :])
    tolerance = relative(expected.drag, 0.01)
    study.row(f"drag, {what}", formula, "N", drag, expected.drag, tolerance)
    tolerance = relative(expected.radius, 0.005)
    study.row(f"radius, {what}", formula, "m", radius, expected.radius, tolerance)
    return study

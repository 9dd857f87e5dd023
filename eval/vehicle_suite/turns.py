"""Slow and fast turns: radius, kerb circle, drag, understeer, step steer, limit."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.formulas import Turn, steady_turn, step_response
from vehicle_suite.report import Study
from vehicle_suite.track import Run, Track, circle_radius, crossing, ramp, step

LOCKS = (0.3, 0.6, 0.85, 1.0)  # of full lock
SPEEDS = (0.5, 1.0, 3.0, -1.0)  # m/s
SPEED = 20.0  # m/s, of the understeer test
ACCELERATIONS = np.arange(0.04, 0.201, 0.04) * GRAVITY  # m/s^2
STEADY = 2.0  # s at the end of a run over which steady values are averaged
STEP_SPEEDS = (5.0, 10.0, 20.0)  # m/s, of step steer
STEP = 1.0  # m/s^2, lateral acceleration that the step asks for
DEGREES = math.degrees(GRAVITY)  # from rad s^2/m to deg/g

# A preset's axles have equal stiffness per load, which makes linear theory neutral;
# these factors make it 11 and 12.5 per rad of 12, a car that understeers.
AXLES = {"preset": (1.0, 1.0), "axles at 11:12.5": (11 / 12, 12.5 / 12)}


def turn_run(
    params: VehicleParameters, lock: float, speed: float, locked_axle: bool = False
) -> Run:
    """Wheels to the lock [rad], then a circle at a speed [m/s]."""
    signals: Any = {"target": ramp(speed, 1.0, 2.0), "steering": ramp(lock, 0.0, 1.0)}
    return Run(params, 8.0 + 10.0 / abs(speed), locked_axle=locked_axle, **signals)


def turning(study: Study) -> None:
    """Radius over steering angle and speed, kerb circle and drag at full lock."""
    params = study.params
    speeds = (1.0, -1.0) if study.quick else SPEEDS
    locks = [f * params.max_steering for f in (LOCKS[-1:] if study.quick else LOCKS)]
    cases = list(itertools.product(speeds, locks))
    tracks = study.bed.drive([turn_run(params, lock, speed) for speed, lock in cases])
    for (speed, lock), track in zip(cases, tracks, strict=True):
        if study.tyres == "brush":
            expected = steady_turn(params, lock, track.late(track.speed, 1.0))
        else:  # geometry alone
            radius = formulas.turning_radius(params, lock)
            expected = Turn(radius, formulas.rolling_drag(params, lock))
        angle, way = math.degrees(lock), "forwards" if speed > 0 else "reverse"
        what = f"turning radius, {angle:.1f} deg, {abs(speed):g} m/s {way}"
        radius = circle_radius(track.position[track.at(7.0) :])
        study.row(what, radius, expected.radius)
        if lock == params.max_steering and speed == 1.0:
            circle = kerb_circle(track)
            geometry = formulas.kerb_circle(params)
            study.row("kerb-to-kerb circle, geometry", circle, geometry)
            study.row("kerb-to-kerb circle, published", circle, params.turning_circle)
            drag = track.late(track.drive.sum(1), 1.0) / params.wheel_radius
            what = "drag at full lock, open differential, 1 m/s"
            study.row(what, drag, expected.drag)


def kerb_circle(track: Track) -> float:
    """Diameter [m] of the circle of the outer front tyre."""
    params = track.params
    late = slice(track.at(7.0), None)
    cos, sin = np.cos(track.yaw[late]), np.sin(track.yaw[late])
    x, y = params.wheelbase, -params.track_width / 2
    hub = track.position[late] + np.stack([x * cos - y * sin, x * sin + y * cos], -1)
    return 2 * circle_radius(hub) + params.tyre_width


def locked_axle(study: Study) -> None:
    """Radius and drag with the driven wheels coupled, against `turning`'s formulas.

    A car with all-wheel drive is driven by its front axle here.
    """
    front = float(round(study.params.front_drive + 0.01))
    params = dataclasses.replace(study.params, front_drive=front)
    lock = LOCKS[0] * params.max_steering
    (track,) = study.bed.drive([turn_run(params, lock, 1.0, locked_axle=True)])
    expected = steady_turn(params, lock, track.late(track.speed, 1.0), locked=True)
    what = f"locked axle, {math.degrees(lock):.1f} deg, 1 m/s"
    drag = track.late(track.drive.sum(1), 1.0) / params.wheel_radius
    radius = circle_radius(track.position[track.at(10.0) :])
    study.row(f"drag, {what}", drag, expected.drag)
    study.row(f"radius, {what}", radius, expected.radius)


def understeer(study: Study) -> None:
    """Gradient of the excess steering angle over lateral acceleration, to 0.2 g."""
    params = study.params
    commands = np.arctan(params.wheelbase * ACCELERATIONS / SPEED**2)
    for axles, factors in AXLES.items():
        tracks = study.bed.drive([_fast_turn(params, c, factors) for c in commands])
        measured = [_excess(track) for track in tracks]
        corrected: list[tuple[float, float]] = []
        for command, track in zip(commands.tolist(), tracks, strict=True):
            speed = track.late(track.speed, STEADY)
            turn = steady_turn(params, command, speed, factors=factors)
            angle = math.atan(params.wheelbase / turn.radius)
            corrected.append((speed**2 / turn.radius, command - angle))
        gradient, brush = (DEGREES * _slope(points) for points in (measured, corrected))
        linear = DEGREES * formulas.understeer_gradient(params, factors)
        study.row(f"understeer gradient, {axles}, linear", gradient, linear)
        study.row(f"understeer gradient, {axles}, brush", gradient, brush)
        for points, label, style in (
            (measured, axles, "o"),
            (corrected, f"{axles}, brush", "--"),
        ):
            x, y = np.transpose(points)
            study.curve("understeer", label, x / GRAVITY, np.degrees(y), style)
        x = ACCELERATIONS / GRAVITY
        study.curve("understeer", f"{axles}, linear", x, linear * x, ":")
        if axles == "preset":
            _load_transfer(study, tracks[-1], "patches")


def rolling_turns(study: Study) -> None:
    """Fast turns on wheels that roll without slip, in the direction they point."""
    params = study.params
    commands = np.arctan(params.wheelbase * ACCELERATIONS / SPEED**2)
    tracks = study.bed.drive([_fast_turn(params, c) for c in commands])
    gradient = DEGREES * _slope([_excess(track) for track in tracks])
    study.row("understeer gradient, preset, rolling", gradient)
    _load_transfer(study, tracks[-1], "rigid")
    for v, angle, track in _step_steers(study):
        gain = math.tan(angle) / angle / params.wheelbase
        expected = gain * track.late(track.speed, 1.0)
        found = track.late(track.yaw_rate, 1.0) / angle
        study.row(f"step steer, yaw-rate gain, {v:g} m/s", found, expected)


def _fast_turn(
    params: VehicleParameters, angle: float, stiffness: tuple[float, float] = (1.0, 1.0)
) -> Run:
    steering = ramp(angle, 0.0, 2.0)
    return Run(params, 12.0, 0.0, SPEED, steering, target=SPEED, stiffness=stiffness)


def _step_steers(study: Study) -> list[tuple[float, float, Track]]:
    """Speeds [m/s], steps of the steering [rad] after 1 s, and the tracks."""
    speeds = STEP_SPEEDS[1:2] if study.quick else STEP_SPEEDS
    angles = [study.params.wheelbase * STEP / v**2 for v in speeds]
    runs = [
        Run(study.params, 6.0, speed=v, target=v, steering=step(angle, 1.0))
        for v, angle in zip(speeds, angles, strict=True)
    ]
    return list(zip(speeds, angles, study.bed.drive(runs), strict=True))


def _excess(track: Track) -> tuple[float, float]:
    """Lateral acceleration [m/s^2], and steering above that of Ackermann [rad]."""
    speed = track.late(track.speed, STEADY)
    curvature = track.late(track.yaw_rate, STEADY) / speed
    angle = math.atan(track.params.wheelbase * curvature)
    return curvature * speed**2, track.late(track.steering, STEADY) - angle


def _load_transfer(study: Study, track: Track, stance: formulas.Stance) -> None:
    load = track.load[-track.at(STEADY) :].mean(0)
    lateral = track.late(track.yaw_rate, STEADY) * track.late(track.speed, STEADY)
    expected = formulas.lateral_load_transfer(track.params, lateral, stance)
    moved = float(load[1] + load[3] - load[0] - load[2]) / 2
    study.row("lateral load transfer, 0.2 g", moved, expected)


def _slope(points: list[tuple[float, float]]) -> float:
    x, y = np.transpose(points)
    return float(np.polyfit(x, y, 1)[0])


def step_steer(study: Study) -> None:
    """Steady yaw-rate gain, and the time to 90 % from half the steering step."""
    params = study.params
    for v, angle, track in _step_steers(study):
        final = track.late(track.yaw_rate, 1.0)
        start = crossing(track.time, track.steering, angle / 2)
        rise = crossing(track.time, track.yaw_rate, 0.9 * final) - start
        reached = track.late(track.speed, 1.0)
        gain = reached / steady_turn(params, angle, reached).radius / angle
        study.row(f"step steer, yaw-rate gain, {v:g} m/s", final / angle, gain)
        time = np.arange(0.0, 4.0, 0.001)
        theory = step_response(params, v, time)
        expected = crossing(time, theory, 0.9 * theory[-1])
        study.row(f"step steer, time to 90 %, {v:g} m/s", rise, expected)
        rows = slice(track.at(0.9), track.at(2.5))
        label, shifted = f"{v:g} m/s", track.time[rows] - start
        study.curve("step_steer", label, shifted, track.yaw_rate[rows] / final)
        study.curve("step_steer", label, time[:1500], theory[:1500] / theory[-1], "--")


def lateral_limit(study: Study) -> None:
    """Largest lateral acceleration of a coasting car under increasing steering."""
    params = study.params
    run = Run(params, 6.0, speed=15.0, steering=ramp(0.3, 0.0, 6.0))
    (track,) = study.bed.drive([run])
    grip = params.tyre.friction * GRAVITY
    window = track.at(0.5)
    smooth = np.ones(window) / window
    mean = np.convolve(track.lateral_acceleration, smooth, "valid") / grip
    what = "lateral limit, 15 m/s, coasting"
    if study.tyres == "brush":
        study.row(what, float(mean.max()), 0.935)
    else:  # sliding contact wheels hop: only long means have a meaning
        study.row(what, track.late(track.lateral_acceleration, STEADY) / grip, 0.965)

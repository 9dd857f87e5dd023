"""Slow and fast turns: radius, kerb circle, drag, understeer, step steer, limit."""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.formulas import Turn, steady_turn, step_response
from vehicle_suite.report import Study
from vehicle_suite.testbeds import Run, Track, circle_radius, crossing, ramp, step

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


def turn_run(params: VehicleParameters, lock: float, speed: float) -> Run:
    """Wheels to the lock [rad], then a circle at a speed [m/s]."""
    signals: Any = {"target": ramp(speed, 1.0, 2.0), "steering": ramp(lock, 0.0, 1.0)}
    return Run(params, 8.0 + 10.0 / abs(speed), **signals)


def drag_of(track: Track) -> float:
    """Drive force [N] over the last second."""
    return track.late(track.drive.sum(1), 1.0) / track.params.wheel_radius


def turning(study: Study) -> None:
    """Radius over steering angle and speed, kerb circle and drag at full lock."""
    params = study.params
    speeds, locks = ((1.0, -1.0), LOCKS[-1:]) if study.quick else (SPEEDS, LOCKS)
    cases = [(v, f * params.max_steering) for v, f in itertools.product(speeds, locks)]
    tracks = study.bed.drive([turn_run(params, lock, speed) for speed, lock in cases])
    for (speed, lock), track in zip(cases, tracks, strict=True):
        if study.tyres == "brush":
            expected = steady_turn(params, lock, track.late(track.speed, 1.0))
        else:  # geometry alone
            radius = formulas.turning_radius(params, lock)
            expected = Turn(radius, formulas.rolling_drag(params, lock))
        what, way = f"{math.degrees(lock):.1f} deg, {abs(speed):g} m/s", speed > 0
        what = f"turning radius, {what} {'forwards' if way else 'reverse'}"
        radius = circle_radius(track.position[track.at(7.0) :])
        study.row(what, radius, expected.radius)
        if lock == params.max_steering and speed == 1.0:
            circle, geometry = kerb_circle(track), formulas.kerb_circle(params)
            study.row("kerb-to-kerb circle, geometry", circle, geometry)
            study.row("kerb-to-kerb circle, published", circle, params.turning_circle)
            what = "drag at full lock, open differential, 1 m/s"
            study.row(what, drag_of(track), expected.drag)


def kerb_circle(track: Track) -> float:
    """Diameter [m] of the circle of the outer front tyre."""
    params, late = track.params, slice(track.at(7.0), None)
    cos, sin = np.cos(track.yaw[late]), np.sin(track.yaw[late])
    x, y = params.wheelbase, -params.track_width / 2
    hub = track.position[late] + np.stack([x * cos - y * sin, x * sin + y * cos], -1)
    return 2 * circle_radius(hub) + params.tyre_width


def fast_turns(
    study: Study, factors: tuple[float, float] = (1.0, 1.0)
) -> list[tuple[float, Track]]:
    """Steering commands [rad] for `ACCELERATIONS`, and the tracks at `SPEED`."""
    commands = np.arctan(study.params.wheelbase * ACCELERATIONS / SPEED**2).tolist()
    fast: Any = {"speed": SPEED, "target": SPEED, "stiffness": factors}
    runs = [
        Run(study.params, 12.0, steering=ramp(angle, 0.0, 2.0), **fast)
        for angle in commands
    ]
    return list(zip(commands, study.bed.drive(runs), strict=True))


def understeer(study: Study) -> None:
    """Gradient of the excess steering angle over lateral acceleration, to 0.2 g."""
    params = study.params
    for axles, factors in AXLES.items():
        turns = fast_turns(study, factors)
        measured = [_excess(track) for _, track in turns]
        corrected: list[tuple[float, float]] = []
        for command, track in turns:
            speed = track.late(track.speed, STEADY)
            turn = steady_turn(params, command, speed, factors=factors)
            angle = math.atan(params.wheelbase / turn.radius)
            corrected.append((speed**2 / turn.radius, command - angle))
        linear = formulas.understeer_gradient(params, factors)
        name = f"understeer gradient, {axles}"
        study.row(f"{name}, linear", _gradient(measured), DEGREES * linear)
        study.row(f"{name}, brush", _gradient(measured), _gradient(corrected))
        straight = [(a, linear * a) for a in ACCELERATIONS]
        for points, label, style in (
            (measured, axles, "o"),
            (corrected, f"{axles}, brush", "--"),
            (straight, f"{axles}, linear", ":"),
        ):
            x, y = np.transpose(points)
            study.curve("understeer", label, x / GRAVITY, np.degrees(y), style)
        if axles == "preset":
            _load_transfer(study, turns[-1][1], "patches")


def rolling_turns(study: Study) -> None:
    """Fast turns on wheels that roll without slip, in the direction they point."""
    tracks = [track for _, track in fast_turns(study)]
    excess = [_excess(track) for track in tracks]
    study.row("understeer gradient, preset, rolling", _gradient(excess))
    _load_transfer(study, tracks[-1], "rigid")
    for name, angle, track in _step_steers(study):
        gain = math.tan(angle) / angle / study.params.wheelbase
        expected = gain * track.late(track.speed, 1.0)
        found = track.late(track.yaw_rate, 1.0) / angle
        study.row(f"step steer, yaw-rate gain, {name}", found, expected)


def _step_steers(study: Study) -> Iterator[tuple[str, float, Track]]:
    """Speeds, steps of the steering [rad] after 1 s, and the tracks."""
    speeds = STEP_SPEEDS[1:2] if study.quick else STEP_SPEEDS
    angles = [study.params.wheelbase * STEP / v**2 for v in speeds]
    runs = [
        Run(study.params, 6.0, speed=v, target=v, steering=step(angle, 1.0))
        for v, angle in zip(speeds, angles, strict=True)
    ]
    names = [f"{v:g} m/s" for v in speeds]
    return zip(names, angles, study.bed.drive(runs), strict=True)


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


def _gradient(points: list[tuple[float, float]]) -> float:
    """Slope of angles [rad] over accelerations [m/s^2], in deg/g."""
    x, y = np.transpose(points)
    return DEGREES * float(np.polyfit(x, y, 1)[0])


def step_steer(study: Study) -> None:
    """Steady yaw-rate gain, and the time to 90 % from half the steering step."""
    params = study.params
    for name, angle, track in _step_steers(study):
        final = track.late(track.yaw_rate, 1.0)
        start = crossing(track.time, track.steering, angle / 2)
        rise = crossing(track.time, track.yaw_rate, 0.9 * final) - start
        speed = track.late(track.speed, 1.0)
        gain = speed / steady_turn(params, angle, speed).radius / angle
        study.row(f"step steer, yaw-rate gain, {name}", final / angle, gain)
        time = np.arange(0.0, 4.0, 0.001)
        theory = step_response(params, float(name.split()[0]), time)
        expected = crossing(time, theory, 0.9 * theory[-1])
        study.row(f"step steer, time to 90 %, {name}", rise, expected)
        rows = slice(track.at(0.9), track.at(2.5))
        shifted, rates = track.time[rows] - start, track.yaw_rate[rows] / final
        study.curve("step_steer", name, shifted, rates)
        study.curve("step_steer", name, time[:1500], theory[:1500] / theory[-1], "--")


def lateral_limit(study: Study) -> None:
    """Largest lateral acceleration of a coasting car under increasing steering."""
    run = Run(study.params, 6.0, speed=15.0, steering=ramp(0.3, 0.0, 6.0))
    (track,) = study.bed.drive([run])
    share = track.lateral_acceleration / (study.params.tyre.friction * GRAVITY)
    what, window = "lateral limit, 15 m/s, coasting", track.at(0.5)
    if study.tyres == "brush":
        mean = np.convolve(share, np.ones(window) / window, "valid")
        study.row(what, float(mean.max()), 0.935)
    else:  # sliding contact wheels hop: only long means have a meaning
        study.row(what, track.late(share, STEADY), 0.965)

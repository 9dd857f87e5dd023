"""Fast cornering: understeer (ISO 4138), step steer (ISO 7401), lateral limit."""

import math

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.runs import Run, ramp, step
from vehicle_suite.steady_turn import steady_turn
from vehicle_suite.step_response import step_response
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed
from vehicle_suite.tracks import Track, crossing

SPEED = 20.0  # m/s, of the understeer test
ACCELERATIONS = np.arange(0.04, 0.201, 0.04) * GRAVITY  # m/s^2
STEADY = 2.0  # s at the end of a run over which steady values are averaged
STEP_SPEEDS = (5.0, 10.0, 20.0)  # m/s, of step steer
STEP = 1.0  # m/s^2, lateral acceleration that the step asks for
DEGREES = math.degrees(GRAVITY)  # from rad s^2/m to deg/g

# A preset's axles have the same stiffness per load, which makes linear theory neutral;
# these factors make it 11 and 12.5 per rad of 12, a car that understeers.
AXLES = {"preset": (1.0, 1.0), "axles at 11:12.5": (11 / 12, 12.5 / 12)}


def understeer(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Gradient of the excess steering angle over lateral acceleration, to 0.2 g."""
    del quick
    study = Study(name, bed.tyres)
    commands = np.arctan(params.wheelbase * ACCELERATIONS / SPEED**2)
    for axles, factors in AXLES.items():
        runs = [
            Run(params, 12.0, speed=SPEED, target=SPEED, steering=ramp(c, 0.0, 2.0),
                stiffness=factors) for c in commands
        ]  # fmt: skip
        measured: list[tuple[float, float]] = []  # lateral acceleration, excess angle
        corrected: list[tuple[float, float]] = []
        tracks = bed.drive(runs)
        for command, track in zip(commands, tracks, strict=True):
            speed = track.late(track.speed, STEADY)
            curvature = track.late(track.yaw_rate, STEADY) / speed
            angle = track.late(track.steering, STEADY)
            measured.append(
                (curvature * speed**2, angle - _ackermann(params, curvature))
            )
            turn = steady_turn(params, float(command), speed, factors=factors)
            excess = float(command) - _ackermann(params, 1 / turn.radius)
            corrected.append((speed**2 / turn.radius, excess))
        gradient, brush = (DEGREES * _slope(points) for points in (measured, corrected))
        linear = DEGREES * formulas.understeer_gradient(params, factors)
        neutral = "a neutral car, whose gradient is near 0: absolute tolerance"
        study.row(
            f"understeer gradient, {axles}, linear",
            "K = (m / L) (b / C_f - a / C_r)",
            "deg/g",
            gradient,
            linear,
            (max(relative(linear, 0.25), 0.1), "" if linear > 0.1 else neutral),
        )
        study.row(
            f"understeer gradient, {axles}, brush",
            "K of the two-track car: brush curvature, load transfer, scrub",
            "deg/g",
            gradient,
            brush,
            (max(relative(brush, 0.05), 0.02), "" if linear > 0.1 else neutral),
        )
        x, y = np.transpose(measured)
        study.curve("understeer", axles, x / GRAVITY, np.degrees(y), "o")
        x, y = np.transpose(corrected)
        study.curve("understeer", f"{axles}, brush", x / GRAVITY, np.degrees(y), "--")
        x = ACCELERATIONS / GRAVITY
        study.curve("understeer", f"{axles}, linear", x, linear * x, ":")
        if axles == "preset":
            _load_transfer(study, tracks[-1], "patches")
    return study


def rolling_turns(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Fast turns on wheels that roll without slip, in the direction they point."""
    study = Study(name, bed.tyres)
    commands = np.arctan(params.wheelbase * ACCELERATIONS / SPEED**2)
    speeds = STEP_SPEEDS[1:2] if quick else STEP_SPEEDS
    angles = [params.wheelbase * STEP / v**2 for v in speeds]
    runs = [
        Run(params, 12.0, speed=SPEED, target=SPEED, steering=ramp(c, 0.0, 2.0))
        for c in commands
    ]
    runs += [
        Run(params, 6.0, speed=v, target=v, steering=step(angle, 1.0))
        for v, angle in zip(speeds, angles, strict=True)
    ]
    tracks = bed.drive(runs)
    measured: list[tuple[float, float]] = []  # lateral acceleration, excess angle
    for track in tracks[: len(commands)]:
        speed = track.late(track.speed, STEADY)
        curvature = track.late(track.yaw_rate, STEADY) / speed
        excess = track.late(track.steering, STEADY) - _ackermann(params, curvature)
        measured.append((curvature * speed**2, excess))
    study.row(
        "understeer gradient, preset, rolling",
        "0: no slip angles",
        "deg/g",
        DEGREES * _slope(measured),
        0.0,
        0.02,
    )
    _load_transfer(study, tracks[len(commands) - 1], "rigid")
    for v, angle, track in zip(speeds, angles, tracks[len(commands) :], strict=True):
        gain = math.tan(angle) / angle / params.wheelbase
        reached = track.late(track.speed, 1.0)
        study.row(
            f"step steer, yaw-rate gain, {v:g} m/s",
            "v tan(delta) / (L delta)",
            "1/s",
            track.late(track.yaw_rate, 1.0) / angle,
            gain * reached,
            relative(gain * reached, 0.01),
        )
    return study


def _load_transfer(study: Study, track: Track, stance: formulas.Stance) -> None:
    load = track.load[-track.at(STEADY) :].mean(0)
    lateral = track.late(track.yaw_rate, STEADY) * track.late(track.speed, STEADY)
    expected = formulas.lateral_load_transfer(track.params, lateral, stance)
    springs = "" if stance == "rigid" else " / (1 - m g h / (k T^2))"
    study.row(
        "lateral load transfer, 0.2 g",
        f"(m h + 4 I / r) a_y / T{springs}",
        "N",
        float(load[1] + load[3] - load[0] - load[2]) / 2,
        expected,
        relative(expected, 0.01),
    )


def _ackermann(params: VehicleParameters, curvature: float) -> float:
    return math.atan(params.wheelbase * curvature)


def _slope(points: list[tuple[float, float]]) -> float:
    x, y = np.transpose(points)
    return float(np.polyfit(x, y, 1)[0])


def step_steer(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Steady yaw-rate gain, and the time to 90 % from half the steering step."""
    study = Study(name, bed.tyres)
    speeds = STEP_SPEEDS[1:2] if quick else STEP_SPEEDS
    angles = [params.wheelbase * STEP / v**2 for v in speeds]
    runs = [
        Run(params, 6.0, speed=v, target=v, steering=step(angle, 1.0))
        for v, angle in zip(speeds, angles, strict=True)
    ]
    for v, angle, track in zip(speeds, angles, bed.drive(runs), strict=True):
        final = track.late(track.yaw_rate, 1.0)
        start = crossing(track.time, track.steering, angle / 2)
        rise = crossing(track.time, track.yaw_rate, 0.9 * final) - start
        reached = track.late(track.speed, 1.0)
        gain = reached / steady_turn(params, angle, reached).radius / angle
        study.row(
            f"step steer, yaw-rate gain, {v:g} m/s",
            "v / (R delta) of the steady two-track turn",
            "1/s",
            final / angle,
            gain,
            relative(gain, 0.01),
        )
        time = np.arange(0.0, 4.0, 0.001)
        theory = step_response(params, v, time)
        expected = crossing(time, theory, 0.9 * theory[-1])
        study.row(
            f"step steer, time to 90 %, {v:g} m/s",
            "linear single-track car with roll and relaxation, from half the step",
            "s",
            rise,
            expected,
            max(0.03, 0.1 * expected),
        )
        rows = slice(track.at(0.9), track.at(2.5))
        label, shifted = f"{v:g} m/s", track.time[rows] - start
        study.curve("step_steer", label, shifted, track.yaw_rate[rows] / final)
        study.curve("step_steer", label, time[:1500], theory[:1500] / theory[-1], "--")
    return study


def lateral_limit(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Largest lateral acceleration of a coasting car under increasing steering."""
    del quick
    study = Study(name, bed.tyres)
    run = Run(params, 6.0, speed=15.0, steering=ramp(0.3, 0.0, 6.0))
    (track,) = bed.drive([run])
    grip = params.tyre.friction * GRAVITY
    window = track.at(0.5)
    smooth = np.ones(window) / window
    mean = np.convolve(track.lateral_acceleration, smooth, "valid") / grip
    what = "lateral limit, 15 m/s, coasting"
    if bed.tyres == "brush":
        study.row(
            what,
            "0.87 to 1.0 mu g, largest mean of 0.5 s",
            "mu g",
            float(mean.max()),
            0.935,
            (
                0.065,
                "loaded outer tyres slide at slip angles above 20 deg, whose cosine is "
                "lost",
            ),
        )
    else:  # sliding contact wheels hop: only long means have a meaning
        late = track.late(track.lateral_acceleration, STEADY) / grip
        formula = f"0.93 to 1.0 mu g, mean of the last {STEADY:g} s, sliding"
        study.row(what, formula, "mu g", late, 0.965, 0.035)
    return study

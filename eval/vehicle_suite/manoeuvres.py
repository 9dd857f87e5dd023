"""Manoeuvres of the test driver: turns, stops, coasting, slopes, and springs."""

import itertools
import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.formulas import Turn, steady_turn, step_response
from vehicle_suite.report import Study
from vehicle_suite.testbeds import (
    LOCKING,
    ContactTestbed,
    Run,
    Track,
    circle_radius,
    crossing,
    ramp,
    step,
)

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


# Straight on

HEADINGS = (0.0, 30.0, 45.0, 90.0)  # degrees
SERVICE = 0.3  # g, brake force over the weight
SLOPES = (0.05, 0.20, 0.30)  # rise over run
FACING = (0.0, 45.0, 90.0, 180.0)  # degrees from uphill
CORNERING = 0.2  # g


def braked_motion(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Distance [m] and speed [m/s] of the centre of gravity until it stands, (n,) each.

    The rear axle's centre on the ground stops sooner: the car pitches forward over it.
    """
    way = np.array([math.cos(track.run.heading), math.sin(track.run.heading)])
    speed = track.cg_velocity[:, :2] @ way
    path = (track.cg - track.cg[0])[:, :2] @ way
    stop = int(np.argmax(speed <= 0.0))
    if not stop:
        return np.array([math.nan]), speed[:1]
    return path[: stop + 1], speed[: stop + 1]


def braking(
    params: VehicleParameters,
    force: float,
    speed: float,
    duration: float,
    **others: Any,
) -> Run:
    """From a speed [m/s] against a brake force over the weight [g]."""
    brake = force * params.mass * GRAVITY
    return Run(params, duration, speed=speed, brake=brake, **others)


def stops(study: Study) -> None:
    """Locked-wheel and 0.3 g stops at four headings.

    Semi-implicit Euler moves with the speed at the end of a substep: a constant
    deceleration stops v dt / 2 short of v^2 / 2a, as if it began half a substep early.
    """
    params = study.params
    stretch = formulas.locking_distance(params) if study.tyres == "brush" else 0.0
    force = SERVICE * params.mass * GRAVITY + formulas.rolling_resistance(params)
    kinds = {  # brake [g], deceleration [m/s^2] and what is added to the way [m]
        "locked wheels": (LOCKING, params.tyre.friction * GRAVITY, stretch),
        "0.3 g": (SERVICE, force / formulas.rolling_mass(params), 0.0),
    }
    headings = HEADINGS[::2] if study.quick else HEADINGS
    starts = ("locked wheels", 5.0), ("0.3 g", 5.0), ("0.3 g", 2.0)
    cases = [(*start, h) for start, h in itertools.product(starts, headings)]
    runs = []
    for what, v, h in cases:
        brake = kinds[what][0]
        duration = 1.0 + v / (min(brake, 0.6) * GRAVITY)
        runs.append(braking(params, brake, v, duration, heading=math.radians(h)))
    for (what, v, heading), track in zip(cases, study.bed.drive(runs), strict=True):
        _, deceleration, more = kinds[what]
        path, speed = braked_motion(track)
        expected = v**2 / (2 * deceleration) - v * track.dt / 2 + more
        row = f"stop, {what}, {v:g} m/s, heading {heading:g} deg"
        study.row(row, float(path[-1]), expected)
        if heading == 0.0 and v == 5.0:
            study.curve("stops", what, path, speed)
            left = np.linspace(v, 0.0, 100)
            theory = (v**2 - left**2) / (2 * deceleration)
            study.curve("stops", what, theory, left, "--")


def straight(study: Study) -> None:
    """Coasting from 3 m/s, and the load that a 0.3 g stop moves."""
    params = study.params
    runs = [Run(params, 5.0, speed=3.0), braking(params, SERVICE, 8.0, 2.4)]
    coasting, braked = study.bed.drive(runs)
    expected = formulas.rolling_resistance(params) / formulas.rolling_mass(params)
    slowing = -coasting.trend(coasting.speed, 1.0, 5.0)
    study.row("coast-down deceleration", slowing, expected)
    still, _ = formulas.axle_loads(params)
    stance: formulas.Stance = "rigid" if study.tyres == "contact" else "patches"
    slowing = -braked.trend(braked.speed, 1.4, 2.4)
    expected = formulas.longitudinal_load_transfer(params, slowing, stance)
    front = braked.load[braked.at(1.4) : braked.at(2.4), :2].sum(1).mean()
    study.row("longitudinal load transfer, 0.3 g", float(front) - still, expected)


def slope_hold(study: Study) -> None:
    """Creep of a car on its holding brake, the worst of four headings."""
    params, duration = study.params, 12.0 if study.quick else 60.0
    settled = duration / 3  # the suspension rocks for some seconds
    for slope in SLOPES[1:2] if study.quick else SLOPES:
        held = params.hold_deceleration * params.mass
        run = partial(Run, params, duration, tilt=math.atan(slope), brake=held)
        tracks = study.bed.drive([run(heading=math.radians(h)) for h in FACING])
        creep = max(x.distance(x.at(settled)) / (duration - settled) for x in tracks)
        study.row(f"creep on a {100 * slope:g} % slope, {duration:g} s", creep)


def suspension(study: Study) -> None:
    """What the optional suspension changes and what it does not."""
    params, steer = study.params, 0.1  # rad
    speed = math.sqrt(CORNERING * GRAVITY * formulas.turning_radius(params, steer))
    braked, turned, circle, locked = ContactTestbed(suspension=True).drive(
        [
            braking(params, SERVICE, 8.0, 2.4),
            Run(params, 8.0, speed=speed, target=speed, steering=ramp(steer, 0.0, 2.0)),
            turn_run(params, params.max_steering, 1.0),
            braking(params, LOCKING, 5.0, 2.0),
        ]
    )

    def row(what: str, measured: float, expected: float = 0.0) -> None:
        study.row(f"suspension: {what}", measured, expected)

    deceleration = -braked.trend(braked.speed, 1.4, 2.4)
    shift = formulas.longitudinal_load_transfer(params, deceleration, "hubs")
    expected = formulas.tilt_angle(params, shift, params.wheelbase)
    pitch = braked.late(-np.arcsin(braked.rotation[:, 2, 0]), 0.5)
    row("pitch braking at 0.3 g", math.degrees(pitch), math.degrees(expected))
    lateral = turned.late(turned.yaw_rate, 1.0) * turned.late(turned.speed, 1.0)
    shift = formulas.lateral_load_transfer(params, lateral, "hubs")
    expected = formulas.tilt_angle(params, shift, params.track_width)
    roll = turned.late(np.arcsin(turned.rotation[:, 2, 1]), 1.0)
    row("roll cornering at 0.2 g", math.degrees(roll), math.degrees(expected))
    radius = circle_radius(circle.position[circle.at(7.0) :])
    expected = formulas.turning_radius(params, params.max_steering)
    row("turning radius, full lock, 1 m/s", radius, expected)
    path, _ = braked_motion(locked)
    expected = 25.0 / (2 * params.tyre.friction * GRAVITY) - 5.0 * locked.dt / 2
    row("stop, locked wheels, 5 m/s", float(path[-1]), expected)

"""Manoeuvres of the test driver: turns, stops, coasting and slopes."""

import itertools
import math
from functools import partial
from typing import Any

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.formulas import steady_turn
from vehicle_suite.report import Study
from vehicle_suite.testbed import LOCKING, Run, Track, circle_radius, ramp, tracks_of

LOCKS = (0.3, 0.6, 0.85, 1.0)  # of full lock
SPEEDS = (0.5, 1.0, 3.0, -1.0)  # m/s
SPEED = 20.0  # m/s, of the understeer test
ACCELERATIONS = np.arange(0.04, 0.201, 0.04) * GRAVITY  # m/s^2
STEADY = 2.0  # s at the end of a run over which steady values are averaged
DEGREES = math.degrees(GRAVITY)  # from rad s^2/m to deg/g

# A preset's axles have equal stiffness per load, which makes linear theory neutral;
# these factors make it 11 and 12.5 per rad of 12, a car that understeers.
AXLES = {"preset": (1.0, 1.0), "axles at 11:12.5": (11 / 12, 12.5 / 12)}


def turn_run(params: VehicleParameters, lock: float, speed: float) -> Run:
    """Wheels to the lock [rad], then a circle at a speed [m/s]."""
    signals: Any = {"target": ramp(speed, 1.0, 2.0), "steering": ramp(lock, 0.0, 1.0)}
    return Run(params, 8.0 + 10.0 / abs(speed), **signals)


def turning(study: Study) -> None:
    """Radius over steering angle and speed, kerb circle and drag at full lock."""
    params = study.params
    speeds, locks = ((1.0, -1.0), LOCKS[-1:]) if study.quick else (SPEEDS, LOCKS)
    cases = [(v, f * params.max_steering) for v, f in itertools.product(speeds, locks)]
    tracks = tracks_of([turn_run(params, lock, speed) for speed, lock in cases])
    for (speed, lock), track in zip(cases, tracks, strict=True):
        expected = steady_turn(params, lock, track.late(track.speed, 1.0))
        what, way = f"{math.degrees(lock):.1f} deg, {abs(speed):g} m/s", speed > 0
        what = f"turning radius, {what} {'forwards' if way else 'reverse'}"
        radius = circle_radius(track.position[track.at(7.0) :])
        study.row(what, radius, expected.radius)
        if lock == params.max_steering and speed == 1.0:
            circle, published = kerb_circle(track), params.turning_circle
            study.row("kerb-to-kerb circle, published", circle, published)
            drag = track.late(track.drive.sum(1), 1.0) / params.wheel_radius
            what = "drag at full lock, open differential, 1 m/s"
            study.row(what, drag, expected.drag)


def kerb_circle(track: Track) -> float:
    """Diameter [m] of the circle of the outer front tyre."""
    params, late = track.params, slice(track.at(7.0), None)
    cos, sin = np.cos(track.yaw[late]), np.sin(track.yaw[late])
    x, y = params.wheelbase, -params.track_width / 2
    hub = track.position[late] + np.stack([x * cos - y * sin, x * sin + y * cos], -1)
    return 2 * circle_radius(hub) + params.tyre_width


def understeer(study: Study) -> None:
    """Gradient of the excess steering angle over lateral acceleration, to 0.2 g."""
    params = study.params
    commands = np.arctan(params.wheelbase * ACCELERATIONS / SPEED**2).tolist()
    for axles, factors in AXLES.items():
        fast: Any = {"speed": SPEED, "target": SPEED, "stiffness": factors}
        tracks = tracks_of(
            [Run(params, 12.0, steering=ramp(x, 0.0, 2.0), **fast) for x in commands]
        )
        measured = [_excess(track) for track in tracks]
        corrected: list[tuple[float, float]] = []
        for command, track in zip(commands, tracks, strict=True):
            speed = track.late(track.speed, STEADY)
            turn = steady_turn(params, command, speed, factors=factors)
            angle = math.atan(params.wheelbase / turn.radius)
            corrected.append((speed**2 / turn.radius, command - angle))
        gradients = _gradient(measured), _gradient(corrected)
        study.row(f"understeer gradient, {axles}", *gradients)
        if axles == "preset":
            track = tracks[-1]
            load = track.load[-track.at(STEADY) :].mean(0)
            lateral = track.late(track.yaw_rate, STEADY)
            lateral *= track.late(track.speed, STEADY)
            expected = formulas.lateral_load_transfer(params, lateral)
            moved = float(load[1] + load[3] - load[0] - load[2]) / 2
            study.row("lateral load transfer, 0.2 g", moved, expected)


def _excess(track: Track) -> tuple[float, float]:
    """Lateral acceleration [m/s^2], and steering above that of Ackermann [rad]."""
    speed = track.late(track.speed, STEADY)
    curvature = track.late(track.yaw_rate, STEADY) / speed
    angle = math.atan(track.params.wheelbase * curvature)
    return curvature * speed**2, track.late(track.steering, STEADY) - angle


def _gradient(points: list[tuple[float, float]]) -> float:
    """Slope of angles [rad] over accelerations [m/s^2], in deg/g."""
    x, y = np.transpose(points)
    return DEGREES * float(np.polyfit(x, y, 1)[0])


def lateral_limit(study: Study) -> None:
    """Largest lateral acceleration of a coasting car under increasing steering."""
    run = Run(study.params, 6.0, speed=15.0, steering=ramp(0.3, 0.0, 6.0))
    (track,) = tracks_of([run])
    share = track.lateral_acceleration / (study.params.tyre.friction * GRAVITY)
    window = np.ones(track.at(0.5)) / track.at(0.5)
    mean = np.convolve(share, window, "valid")
    study.row("lateral limit, 15 m/s, coasting", float(mean.max()), 0.935)


# Straight on

HEADINGS = (0.0, 30.0, 45.0, 90.0)  # degrees
SERVICE = 0.3  # g, brake force over the weight
SLOPES = (0.05, 0.20, 0.30)  # rise over run
FACING = (0.0, 45.0, 90.0, 180.0)  # degrees from uphill


def braked_way(track: Track) -> float:
    """Way [m] of the centre of gravity until it stands; NaN if it does not.

    The rear axle's centre on the ground stops sooner: the car pitches forward over it.
    """
    way = np.array([math.cos(track.run.heading), math.sin(track.run.heading)])
    speed = track.cg_velocity[:, :2] @ way
    stop = int(np.argmax(speed <= 0.0))
    return float((track.cg[stop] - track.cg[0])[:2] @ way) if stop else math.nan


def stops(study: Study) -> None:
    """Locked-wheel and 0.3 g stops at four headings.

    Semi-implicit Euler moves with the speed at the end of a substep: a constant
    deceleration stops v dt / 2 short of v^2 / 2a, as if it began half a substep early.
    """
    params = study.params
    weight, stretch = params.mass * GRAVITY, formulas.locking_distance(params)
    force = SERVICE * weight + formulas.rolling_resistance(params)
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
        duration, heading = 1.0 + v / (min(brake, 0.6) * GRAVITY), math.radians(h)
        runs.append(
            Run(params, duration, speed=v, brake=brake * weight, heading=heading)
        )
    for (what, v, heading), track in zip(cases, tracks_of(runs), strict=True):
        _, deceleration, more = kinds[what]
        expected = v**2 / (2 * deceleration) - v * track.dt / 2 + more
        row = f"stop, {what}, {v:g} m/s, heading {heading:g} deg"
        study.row(row, braked_way(track), expected)


def straight(study: Study) -> None:
    """Coasting from 3 m/s, and the load that a 0.3 g stop moves."""
    params = study.params
    brake = SERVICE * params.mass * GRAVITY
    runs = [Run(params, 5.0, speed=3.0), Run(params, 2.4, speed=8.0, brake=brake)]
    coasting, braked = tracks_of(runs)
    expected = formulas.rolling_resistance(params) / formulas.rolling_mass(params)
    slowing = -coasting.trend(coasting.speed, 1.0, 5.0)
    study.row("coast-down deceleration", slowing, expected)
    still, _ = formulas.axle_loads(params)
    slowing = -braked.trend(braked.speed, 1.4, 2.4)
    expected = formulas.longitudinal_load_transfer(params, slowing)
    front = braked.load[braked.at(1.4) : braked.at(2.4), :2].sum(1).mean()
    study.row("longitudinal load transfer, 0.3 g", float(front) - still, expected)


def slope_hold(study: Study) -> None:
    """Creep of a car on its holding brake, the worst of four headings."""
    params, duration = study.params, 12.0 if study.quick else 60.0
    settled = duration / 3  # the suspension rocks for some seconds
    for slope in SLOPES[1:2] if study.quick else SLOPES:
        held = params.hold_deceleration * params.mass
        run = partial(Run, params, duration, tilt=math.atan(slope), brake=held)
        tracks = tracks_of([run(heading=math.radians(h)) for h in FACING])
        creep = max(x.distance(x.at(settled)) / (duration - settled) for x in tracks)
        study.row(f"creep on a {100 * slope:g} % slope, {duration:g} s", creep)

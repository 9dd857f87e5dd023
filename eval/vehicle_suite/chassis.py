"""Stops, coasting, slopes, wheel loads, and springs."""

import itertools
import math
from functools import partial
from typing import Any

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.report import Study
from vehicle_suite.testbeds import (
    LOCKING,
    ContactTestbed,
    Run,
    Track,
    circle_radius,
    ramp,
)
from vehicle_suite.turns import turn_run

HEADINGS = (0.0, 30.0, 45.0, 90.0)  # degrees
SERVICE = 0.3  # g, brake force over the weight
SLOPES = (0.05, 0.20, 0.30)  # rise over run
FACING = (0.0, 45.0, 90.0, 180.0)  # degrees from uphill
CORNERING = 0.2  # g
SPRUNG = ContactTestbed(suspension=True)


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
    """Coasting from 3 m/s, the load that a 0.3 g stop moves, and that at rest."""
    params = study.params
    coasting, braked, stopped = study.bed.drive(
        [
            Run(params, 5.0, speed=3.0),
            braking(params, SERVICE, 8.0, 2.4),
            braking(params, SERVICE, 2.0, 6.0),
        ]
    )
    expected = formulas.rolling_resistance(params) / formulas.rolling_mass(params)
    slowing = -coasting.trend(coasting.speed, 1.0, 5.0)
    study.row("coast-down deceleration", slowing, expected)
    still, _ = formulas.axle_loads(params)
    stance: formulas.Stance = "rigid" if study.tyres == "contact" else "patches"
    slowing = -braked.trend(braked.speed, 1.4, 2.4)
    expected = formulas.longitudinal_load_transfer(params, slowing, stance)
    front = braked.load[braked.at(1.4) : braked.at(2.4), :2].sum(1).mean()
    study.row("longitudinal load transfer, 0.3 g", float(front) - still, expected)
    front = stopped.late(stopped.load[:, :2].sum(1), 2.0)
    study.row("static front axle load", front, still)


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
    rest = Run(params, 10.0)
    braked, turned, circle, locked, stood = SPRUNG.drive(
        [
            braking(params, SERVICE, 8.0, 2.4),
            Run(params, 8.0, speed=speed, target=speed, steering=ramp(steer, 0.0, 2.0)),
            turn_run(params, params.max_steering, 1.0),
            braking(params, LOCKING, 5.0, 2.0),
            rest,
        ]
    )
    (rigid,) = ContactTestbed().drive([rest])

    def row(what: str, measured: float, expected: float = 0.0) -> None:
        study.row(f"suspension: {what}", measured, expected)

    height = 1000 * float(stood.cg[-1, 2] - rigid.cg[-1, 2])
    row("ride height over the rigid car's", height)
    row("drift at rest, 10 s", stood.distance(stood.at(1.0)) / 9.0)
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

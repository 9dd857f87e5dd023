"""Stopping, coasting and the load that moves to the front axle."""

import itertools
import math

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.runs import LOCKING, Run
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed
from vehicle_suite.tracks import Track

HEADINGS = (0.0, 30.0, 45.0, 90.0)  # degrees
SERVICE = 0.3  # g, brake force over the weight


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


def stops(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """Locked-wheel and 0.3 g stops at four headings.

    Semi-implicit Euler moves with the speed at the end of a substep: a constant
    deceleration stops v dt / 2 short of v^2 / 2a, as if it began half a substep early.
    """
    study = Study(name, bed.tyres)
    headings = HEADINGS[::2] if quick else HEADINGS
    cases = [(LOCKING, 5.0, h) for h in headings]
    cases += [(SERVICE, v, h) for v, h in itertools.product((5.0, 2.0), headings)]
    weight = params.mass * GRAVITY
    runs = [
        Run(params, 1.0 + v / (min(g, 0.6) * GRAVITY), heading=math.radians(h),
            speed=v, brake=g * weight) for g, v, h in cases
    ]  # fmt: skip
    for (g, v, heading), track in zip(cases, bed.drive(runs), strict=True):
        stretch = 0.0
        if g == LOCKING:
            what, formula = "locked wheels", "v^2 / (2 mu g) - v dt / 2"
            if bed.tyres == "brush":
                formula += " + 3 mu sigma_x / (4 c_x)"
                stretch = formulas.locking_distance(params)
            deceleration, share = params.tyre.friction * GRAVITY, 0.01
        else:
            what = "0.3 g"
            formula = "v^2 m_eff / (2 F) - v dt / 2, m_eff = m + 4 I / r^2"
            force = g * weight + formulas.rolling_resistance(params)
            deceleration = force / formulas.rolling_mass(params)
            share = 0.002 if bed.tyres == "brush" else 0.01
        path, speed = braked_motion(track)
        expected = v**2 / (2 * deceleration) - v * track.dt / 2 + stretch
        study.row(
            f"stop, {what}, {v:g} m/s, heading {heading:g} deg",
            formula,
            "m",
            float(path[-1]),
            expected,
            relative(expected, share),
        )
        if heading == 0.0 and v == 5.0:
            study.curve("stops", what, path, speed)
            left = np.linspace(v, 0.0, 100)
            theory = (v**2 - left**2) / (2 * deceleration)
            study.curve("stops", what, theory, left, "--")
    return study


def coast_down(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Deceleration of a car that rolls freely from 3 m/s."""
    del quick
    study = Study(name, bed.tyres)
    (track,) = bed.drive([Run(params, 5.0, speed=3.0)])
    slope = track.trend(track.speed, 1.0, 5.0)
    expected = formulas.rolling_resistance(params) / formulas.rolling_mass(params)
    study.row(
        "coast-down deceleration",
        "c_rr m g / (m + 4 I / r^2)",
        "m/s^2",
        -slope,
        expected,
        relative(expected, 0.002),
    )
    return study


def load_transfer(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Load that a long 0.3 g stop moves to the front axle."""
    del quick
    study = Study(name, bed.tyres)
    run = Run(params, 2.4, speed=8.0, brake=SERVICE * params.mass * GRAVITY)
    (track,) = bed.drive([run])
    deceleration = -track.trend(track.speed, 1.4, 2.4)
    front = track.load[track.at(1.4) : track.at(2.4), :2].sum(1).mean()
    rigid = bed.tyres == "contact"
    stance: formulas.Stance = "rigid" if rigid else "patches"
    expected = formulas.longitudinal_load_transfer(params, deceleration, stance)
    study.row(
        "longitudinal load transfer, 0.3 g",
        "(m h + 4 I / r) a / L" + ("" if rigid else " / (1 - m g h / (k L^2))"),
        "N",
        float(front) - formulas.axle_loads(params)[0],
        expected,
        relative(expected, 0.01),
    )
    return study

"""Stopping, coasting and the load that moves to the front axle."""

import itertools
import math

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY
from physics import formulas
from physics.cornering import Cars
from physics.runs import Run, Track
from physics.table import Curve, Row, Study, relative
from physics.testbed import Testbed

HEADINGS = (0.0, 30.0, 45.0, 90.0)  # degrees
LOCKING = 20.0  # g, brake force that locks every wheel at once
SERVICE = 0.3  # g


def stopping_distance(track: Track) -> float:
    """From the first braked substep to standstill [m]."""
    last = int(np.argmax(track.speed <= 0.0))
    return track.distance(0, last) if last else math.nan


def stops(bed: Testbed, cars: Cars, quick: bool = False) -> Study:
    """Locked-wheel and 0.3 g stops at four headings, from 5 and 2 m/s.

    Semi-implicit Euler moves with the speed at the end of a substep: a constant
    deceleration stops v dt / 2 short of v^2 / 2a, as if it began half a substep early.
    """
    study = Study()
    headings = HEADINGS[::2] if quick else HEADINGS
    cases = [(LOCKING, 5.0, h) for h in headings]
    cases += [(SERVICE, v, h) for v, h in itertools.product((5.0, 2.0), headings)]
    for name, params in cars.items():
        weight = params.mass * GRAVITY
        runs = [
            Run(params, 1.0 + v / (min(g, 0.6) * GRAVITY), heading=math.radians(h),
                speed=v, brake=g * weight) for g, v, h in cases
        ]  # fmt: skip
        for (g, v, heading), track in zip(cases, bed.drive(runs), strict=True):
            if g == LOCKING:
                what, formula = "locked wheels", "v^2 / (2 mu g) - v dt / 2"
                deceleration, share, why = params.tyre.friction * GRAVITY, 0.01, ""
            else:
                what = "0.3 g"
                formula = "v^2 m_eff / (2 F) - v dt / 2, m_eff = m + 4 I / r^2"
                force = g * weight + formulas.rolling_resistance(params)
                deceleration = force / formulas.rolling_mass(params)
                share, why = (0.01, "") if v > 2 else (0.02, "pitching, bristle travel")
            expected = v**2 / (2 * deceleration) - v * track.dt / 2
            study.rows.append(
                Row(
                    f"stop, {what}, {v:g} m/s, heading {heading:g} deg",
                    name,
                    bed.tyres,
                    formula,
                    "m",
                    stopping_distance(track),
                    expected,
                    relative(expected, share),
                    why,
                )
            )
            if heading == 0.0 and v == 5.0:
                end = int(np.argmax(track.speed <= 0.0)) + 1
                path = np.linalg.norm(track.position - track.position[0], axis=1)[:end]
                label = f"{name}, {bed.tyres}, {what}"
                study.curves.append(Curve("stops", label, path, track.speed[:end], "-"))
                left = 2 * deceleration * np.linspace(0, v**2 / 2 / deceleration, 100)
                study.curves.append(
                    Curve("stops", f"{label}, formula", left / 2 / deceleration,
                          np.sqrt(np.maximum(v**2 - left, 0)), "--")
                )  # fmt: skip
    return study


def coast_down(bed: Testbed, cars: Cars) -> Study:
    """Deceleration of a car that rolls freely from 3 m/s."""
    study = Study()
    runs = [Run(params, 5.0, speed=3.0) for params in cars.values()]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        params = track.params
        rows = slice(track.at(1.0), None)
        slope = np.polyfit(track.time[rows], track.speed[rows], 1)[0]
        expected = formulas.rolling_resistance(params) / formulas.rolling_mass(params)
        study.rows.append(
            Row("coast-down deceleration", name, bed.tyres, "c_rr m g / (m + 4 I / r^2)",
                "m/s^2", -float(slope), expected, relative(expected, 0.002))
        )  # fmt: skip
    return study


def load_transfer(bed: Testbed, cars: Cars) -> Study:
    """Load that a long 0.3 g stop moves to the front axle."""
    study = Study()
    runs = [
        Run(p, 2.4, speed=8.0, brake=SERVICE * p.mass * GRAVITY) for p in cars.values()
    ]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        params = track.params
        rows = slice(track.at(1.4), track.at(2.4))
        deceleration = -np.polyfit(track.time[rows], track.speed[rows], 1)[0]
        front = float(track.load[rows, :2].sum(1).mean())
        measured = front - formulas.axle_loads(params)[0]
        expected = formulas.longitudinal_load_transfer(params, float(deceleration))
        study.rows.append(
            Row("longitudinal load transfer, 0.3 g", name, bed.tyres,
                "(m h + 4 I / r) a / L / (1 - m g h / (k L^2))", "N", measured, expected,
                relative(expected, 0.01))
        )  # fmt: skip
    return study

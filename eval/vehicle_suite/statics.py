"""Tests at standstill: axle loads, hold on slopes, slip threshold, scrub torque."""

import math

import numpy as np

from carpark_mj.vehicle.mjcf import STEER_STIFFNESS
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.runs import LOCKING, Run, ramp
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed

SLOPES = (0.05, 0.20, 0.30)  # rise over run
FACING = (0.0, 45.0, 90.0, 180.0)  # degrees from uphill


def axle_loads(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Front axle load of a car that drove and stopped."""
    del quick
    study = Study(name, bed.tyres)
    run = Run(params, 6.0, speed=2.0, brake=0.3 * params.mass * GRAVITY)
    (track,) = bed.drive([run])
    expected = formulas.axle_loads(params)[0]
    measured = track.late(track.load[:, :2].sum(1), 2.0)
    tolerance = relative(expected, 0.005)
    study.row("static front axle load", "m g b / L", "N", measured, expected, tolerance)
    return study


def slope_hold(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Creep of a car on its holding brake, the worst of four headings."""
    study = Study(name, bed.tyres)
    duration = 12.0 if quick else 60.0
    settled = duration / 3  # the suspension rocks for some seconds
    for slope in SLOPES[1:2] if quick else SLOPES:
        runs = [
            Run(params, duration, heading=math.radians(h), tilt=math.atan(slope),
                brake=params.hold_deceleration * params.mass) for h in FACING
        ]  # fmt: skip
        creep = max(
            track.distance(track.at(settled), -1) / (duration - settled)
            for track in bed.drive(runs)
        )
        brush = bed.tyres == "brush"
        study.row(
            f"creep on a {100 * slope:g} % slope, {duration:g} s",
            "0, below the friction limit",
            "m/s",
            creep,
            0.0,
            (
                1e-5 if brush else 2e-3 * slope,
                "" if brush else "regularised friction creeps with the slope",
            ),
        )
    return study


def slip_threshold(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Tilt at which a car on locked wheels begins to slide, lengthways and sideways."""
    del quick
    study = Study(name, bed.tyres)
    expected = math.degrees(math.atan(params.tyre.friction))

    def tilt(time: np.ndarray) -> np.ndarray:
        fast = np.minimum(time / 10.0, 1.0) * (expected - 4.0)
        return np.radians(fast + 0.25 * np.maximum(time - 15.0, 0.0))

    brake = LOCKING * params.mass * GRAVITY
    runs = [
        Run(params, 36.0, heading=math.radians(h), tilt=tilt, brake=brake)
        for h in (0.0, 90.0)
    ]
    for facing, track in zip(("uphill", "sideways"), bed.drive(runs), strict=True):
        speed = np.linalg.norm(track.qvel[:, :2], axis=1)
        speed[: track.at(15.0)] = 0.0  # settling
        row = int(np.argmax(speed > 0.01))
        angle = math.degrees(tilt(track.time[row : row + 1])[0]) if row else math.nan
        what = f"slip threshold, facing {facing}"
        study.row(what, "tan(tilt) = mu", "deg", angle, expected, 0.5)
    return study


def scrub_torque(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """Torque of the steering servos that turn the wheels of a standing car."""
    del quick
    study = Study(name, bed.tyres)
    lock = 0.3
    brake = LOCKING * params.mass * GRAVITY
    run = Run(params, 5.0, steering=ramp(lock, 0.5, 3.0), brake=brake)
    (track,) = bed.drive([run])
    target = np.array(formulas.front_wheel_angles(params, lock))
    torque = STEER_STIFFNESS * (target - track.wheel_angles)
    scrub = formulas.scrub_torque(params)
    brush = bed.tyres == "brush"
    study.row(
        "scrub torque at standstill, a front wheel",
        "2/3 mu F_z R_p" if brush else "0: a point contact does not twist (condim 3)",
        "N m",
        track.late(torque.mean(1), 0.5),
        scrub if brush else 0.0,
        relative(scrub, 0.05),
    )
    return study

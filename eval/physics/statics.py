"""Standing: axle loads, hold on slopes, slip threshold, scrub torque."""

import math

import numpy as np

from carpark_mj.vehicle.mjcf import STEER_STIFFNESS
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from physics import formulas
from physics.braking import LOCKING
from physics.cornering import Cars
from physics.runs import Run, ramp
from physics.table import Curve, Row, Study, relative
from physics.testbed import Testbed

SLOPES = (0.05, 0.20, 0.30)  # rise over run
FACING = (0.0, 45.0, 90.0, 180.0)  # degrees from uphill


def axle_loads(bed: Testbed, cars: Cars) -> Study:
    """Front axle load of a car that drove and stopped."""
    study = Study()
    runs = [Run(p, 6.0, speed=2.0, brake=0.3 * p.mass * GRAVITY) for p in cars.values()]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        expected = formulas.axle_loads(track.params)[0]
        measured = float(track.load[track.at(4.0) :, :2].sum(1).mean())
        study.rows.append(
            Row("static front axle load", name, bed.tyres, "m g b / L", "N", measured,
                expected, relative(expected, 0.005))
        )  # fmt: skip
    return study


def slope_hold(bed: Testbed, cars: Cars, quick: bool = False) -> Study:
    """Creep of a car on its holding brake, the worst of four headings, over 60 s."""
    study = Study()
    duration = 12.0 if quick else 60.0
    settled = duration / 3  # the suspension rocks for some seconds
    limit = 1e-5 if bed.tyres == "brush" else 1e-4
    for name, params in cars.items():
        for slope in SLOPES[1:2] if quick else SLOPES:
            runs = [
                Run(params, duration, heading=math.radians(h), tilt=math.atan(slope),
                    brake=params.hold_deceleration * params.mass) for h in FACING
            ]  # fmt: skip
            creep = max(
                track.distance(track.at(settled), -1) / (duration - settled)
                for track in bed.drive(runs)
            )
            study.rows.append(
                Row(f"creep on a {100 * slope:g} % slope, {duration:g} s", name,
                    bed.tyres, "0, below the friction limit", "m/s", creep, 0.0, limit)
            )  # fmt: skip
    return study


def slip_threshold(bed: Testbed, cars: Cars) -> Study:
    """Tilt at which a car on locked wheels begins to slide, lengthways and sideways."""
    study = Study()
    for name, params in cars.items():
        expected = math.degrees(math.atan(params.tyre.friction))
        first = expected - 4.0

        def tilt(time: np.ndarray, first: float = first) -> np.ndarray:
            fast = np.minimum(time / 10.0, 1.0) * first
            return np.radians(fast + 0.25 * np.maximum(time - 15.0, 0.0))

        runs = [
            Run(params, 36.0, heading=math.radians(h), tilt=tilt,
                brake=LOCKING * params.mass * GRAVITY) for h in (0.0, 90.0)
        ]  # fmt: skip
        for what, track in zip(("uphill", "sideways"), bed.drive(runs), strict=True):
            speed = np.linalg.norm(track.qvel[:, :2], axis=1)
            late = track.at(15.0)
            row = late + int(np.argmax(speed[late:] > 0.01))
            angle = math.degrees(tilt(track.time[row : row + 1])[0])
            study.rows.append(
                Row(f"slip threshold, facing {what}", name, bed.tyres, "tan(tilt) = mu",
                    "deg", angle if row > late else math.nan, expected, 0.5)
            )  # fmt: skip
    return study


def scrub_torque(bed: Testbed, cars: Cars) -> Study:
    """Torque of the steering servos that turn the wheels of a standing car."""
    study = Study()
    lock = 0.3
    runs = [
        Run(p, 5.0, steering=ramp(lock, 0.5, 3.0), brake=LOCKING * p.mass * GRAVITY)
        for p in cars.values()
    ]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        expected = formulas.scrub_torque(track.params)
        wheels = np.array(front_wheel_angles(track.params, lock))
        torque = STEER_STIFFNESS * (wheels - track.wheel_angles)
        study.rows.append(
            Row("scrub torque at standstill, a front wheel", name, bed.tyres,
                "2/3 mu F_z R_p", "N m", float(torque[-50:].mean()), expected,
                relative(expected, 0.05))
        )  # fmt: skip
        tan = np.tan(np.clip((track.time - 0.5) / 3.0, 0.0, 1.0) * lock)
        command = np.arctan(tan / (1 - _skew(track.params) * tan))
        moving = STEER_STIFFNESS * (command - track.wheel_angles[:, 0])
        study.curves.append(
            Curve("scrub", f"{name}, {bed.tyres}", np.degrees(command), moving, "-")
        )
    return study


def front_wheel_angles(
    params: VehicleParameters, steering: float
) -> tuple[float, float]:
    """Left and right [rad] for a bicycle angle: tan d / (1 -+ f T / (2 L) tan d)."""
    tan = math.tan(steering)
    skew = _skew(params) * tan
    return math.atan(tan / (1 - skew)), math.atan(tan / (1 + skew))


def _skew(params: VehicleParameters) -> float:
    return params.ackermann * params.track_width / (2 * params.wheelbase)

"""Energy: what the drive puts in is found again as motion, rolling and slip losses."""

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY
from physics import formulas
from physics.cornering import Cars
from physics.runs import Run, Track
from physics.table import Row, Study
from physics.testbed import Testbed

PULL = 0.15  # g, drive force over the weight


def balance(bed: Testbed, cars: Cars) -> Study:
    """Lost share of the drive's work while accelerating and of the motion, coasting."""
    study = Study()
    runs = [
        Run(p, 5.0, speed=0.5, force=PULL * p.mass * GRAVITY) for p in cars.values()
    ]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        first, last = track.at(2.0), track.at(5.0)  # after the car has pitched
        work = _integral(track, track.drive * spin(track), first, last)
        gained = track.kinetic_energy(last) - track.kinetic_energy(first)
        rest = (work - gained - rolling_loss(track, first, last)) / work
        expected = slip_loss(track, work) if bed.tyres == "brush" else 0.0
        study.rows.append(
            Row("energy balance, accelerating at 0.15 g", name, bed.tyres,
                "slip loss sum F_x s / sum F of the brush, less m a^2 dt / P"
                if bed.tyres == "brush" else "no loss",
                "of the work", rest, expected, 5e-4,
                "slip is formed with the spin after and the speed before a substep"
                if bed.tyres == "brush" else "")
        )  # fmt: skip
    runs = [Run(p, 5.0, speed=3.0) for p in cars.values()]
    for name, track in zip(cars, bed.drive(runs), strict=True):
        first, last = track.at(1.0), track.at(5.0)
        lost = track.kinetic_energy(first) - track.kinetic_energy(last)
        rest = (lost - rolling_loss(track, first, last)) / lost
        study.rows.append(
            Row("energy balance, coasting from 3 m/s", name, bed.tyres,
                "lost motion = c_rr sum F_z r omega", "of the loss", rest, 0.0, 0.001)
        )  # fmt: skip
    return study


def rolling_loss(track: Track, first: int, last: int) -> float:
    """Work of the rolling resistance c_rr F_z r on the spinning wheels [J]."""
    params = track.params
    torque = params.tyre.rolling_resistance * track.load * params.wheel_radius
    return _integral(track, torque * np.abs(spin(track)), first, last)


def spin(track: Track) -> np.ndarray:
    """(T, 4) mean wheel spin during each substep [rad/s]."""
    return (track.spin[1:] + track.spin[:-1]) / 2


def slip_loss(track: Track, work: float) -> float:
    """Expected slip loss from 2 s to 5 s as a share of the drive's work [J].

    Over a substep the tyre dissipates F (omega_after r - v_before), the bodies' motion
    gives F (mean omega r - mean v): the difference m a^2 dt is a gain of the time step.
    """
    params = track.params
    rolling = formulas.rolling_resistance(params)
    force = PULL * params.mass * GRAVITY
    acceleration = (force - rolling) / formulas.rolling_mass(params)
    shift = formulas.longitudinal_load_transfer(params, acceleration)
    static = formulas.axle_loads(params)
    loads = static[0] - shift, static[1] + shift
    drives = params.front_drive, 1.0 - params.front_drive
    spinning = 2 * params.wheel_inertia / params.wheel_radius**2 * acceleration
    loss = 0.0
    for load, still, share in zip(loads, static, drives, strict=True):
        ground = share * force - params.tyre.rolling_resistance * load - spinning
        slip = formulas.brush_slip(
            ground, params.tyre.slip_stiffness * still, params.tyre.friction * load
        )
        loss += abs(ground) * slip
    return loss / force - params.mass * acceleration**2 * track.dt * 3.0 / work


def _integral(track: Track, power: np.ndarray, first: int, last: int) -> float:
    return float(power[first:last].sum() * track.dt)

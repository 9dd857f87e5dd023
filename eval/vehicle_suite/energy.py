"""Energy balance: the drive's work equals motion, rolling and slip losses."""

import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.runs import Run
from vehicle_suite.steady_turn import brush_slip
from vehicle_suite.table import Study
from vehicle_suite.testbed import Testbed
from vehicle_suite.tracks import Track

PULL = 0.15  # g, drive force over the weight
FIRST, LAST = 2.0, 5.0  # s, between which the car neither pitches nor heaves


def balance(bed: Testbed, name: str, params: VehicleParameters, quick: bool) -> Study:
    """Lost share of the drive's work while accelerating, of the motion coasting."""
    del quick
    study = Study(name, bed.tyres)
    pull = Run(params, LAST, speed=0.5, force=PULL * params.mass * GRAVITY)
    driven, coasting = bed.drive([pull, Run(params, LAST, speed=3.0)])
    work = _work(driven, driven.drive)
    rest = (work - _gained(driven) - rolling_loss(driven)) / work
    brush = bed.tyres == "brush"
    study.row(
        "energy balance, accelerating at 0.15 g",
        "slip loss sum F_x s / sum F of the brush - m a^2 dt / P" if brush else "0",
        "of the work",
        rest,
        slip_loss(driven, work) if brush else 0.0,
        (
            5e-4,
            "slip is formed with the spin after and the speed before a substep"
            if brush
            else "",
        ),
    )
    lost = -_gained(coasting)
    study.row(
        "energy balance, coasting from 3 m/s",
        "lost motion = c_rr sum F_z r omega",
        "of the loss",
        (lost - rolling_loss(coasting)) / lost,
        0.0,
        1e-3,
    )
    return study


def _gained(track: Track) -> float:
    first, last = track.at(FIRST), track.at(LAST)
    return track.kinetic_energy(last) - track.kinetic_energy(first)


def _work(track: Track, torque: np.ndarray) -> float:
    """Work [J] of torques (T, 4) on the wheels, with the mean spin of each substep."""
    spin = (track.spin[1:] + track.spin[:-1]) / 2
    rows = slice(track.at(FIRST), track.at(LAST))
    return float((torque * spin)[rows].sum()) * track.dt


def rolling_loss(track: Track) -> float:
    """Work of the rolling resistance c_rr F_z r [J] of a car that drives forwards."""
    params = track.params
    torque = params.tyre.rolling_resistance * track.load * params.wheel_radius
    return _work(track, torque)


def slip_loss(track: Track, work: float) -> float:
    """Expected slip loss as a share of the drive's work [J].

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
        stiffness = params.tyre.slip_stiffness * still
        loss += abs(ground) * brush_slip(ground, stiffness, params.tyre.friction * load)
    early = params.mass * acceleration**2 * track.dt * (LAST - FIRST) / work
    return loss / force - early

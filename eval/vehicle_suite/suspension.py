"""Contact wheels on springs: ride height, bounce, pitch, roll, turning and stopping."""

import math

import mujoco
import numpy as np

from carpark_mj.vehicle.mjcf import WHEELS, chassis_inertial, hub_positions
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.braking import SERVICE, braked_motion
from vehicle_suite.contact import ContactTestbed, contact_model, rigid_joints
from vehicle_suite.runs import LOCKING, Run, ramp
from vehicle_suite.table import Study, relative
from vehicle_suite.testbed import Testbed
from vehicle_suite.tracks import Track, circle_radius
from vehicle_suite.turning import turn_run

CORNERING = 0.2  # g
BED = ContactTestbed(suspension=True)


def suspension(
    bed: Testbed, name: str, params: VehicleParameters, quick: bool
) -> Study:
    """What the optional suspension changes and what it does not."""
    del quick
    study = Study(name, bed.tyres)
    brake = SERVICE * params.mass * GRAVITY
    steer = 0.1  # rad
    radius = formulas.turning_radius(params, steer)
    speed = math.sqrt(CORNERING * GRAVITY * radius)
    rest = Run(params, 10.0)
    braked, turned, circle, locked, stood = BED.drive(
        [
            Run(params, 2.4, speed=8.0, brake=brake),
            Run(params, 8.0, speed=speed, target=speed, steering=ramp(steer, 0.0, 2.0)),
            turn_run(params, params.max_steering, 1.0),
            Run(params, 2.0, speed=5.0, brake=LOCKING * params.mass * GRAVITY),
            rest,
        ]
    )
    (rigid,) = ContactTestbed().drive([rest])
    _standing(study, stood, rigid)
    measured = bounce_frequency(params, BED.dt)
    expected, _ = formulas.bounce(params)
    study.row(
        "suspension: bounce frequency",
        "slower mode of heave and pitch, sqrt(4 k / m) / 2 pi if decoupled, damped",
        "Hz",
        measured,
        expected,
        relative(expected, 0.01),
    )
    _pitch(study, braked)
    _roll(study, turned)
    radius = formulas.turning_radius(params, params.max_steering)
    study.row(
        "suspension: turning radius, full lock, 1 m/s",
        "R = L / tan(delta)",
        "m",
        circle_radius(circle.position[circle.at(7.0) :]),
        radius,
        relative(radius, 0.01),
    )
    path, _ = braked_motion(locked)
    expected = 25.0 / (2 * params.tyre.friction * GRAVITY) - 5.0 * locked.dt / 2
    study.row(
        "suspension: stop, locked wheels, 5 m/s",
        "v^2 / (2 mu g) - v dt / 2",
        "m",
        float(path[-1]),
        expected,
        relative(expected, 0.01),
    )
    return study


def _standing(study: Study, stood: Track, rigid: Track) -> None:
    study.row(
        "suspension: ride height over the rigid car's",
        "0: springs preloaded by the static load",
        "mm",
        1000 * float(stood.cg[-1, 2] - rigid.cg[-1, 2]),
        0.0,
        0.1,
    )
    drift = stood.distance(stood.at(1.0)) / 9.0
    study.row("suspension: drift at rest, 10 s", "0", "m/s", drift, 0.0, 1e-5)


def _pitch(study: Study, track: Track) -> None:
    params = track.params
    deceleration = -track.trend(track.speed, 1.4, 2.4)
    shift = formulas.longitudinal_load_transfer(params, deceleration, "hubs")
    expected = math.degrees(formulas.tilt_angle(params, shift, params.wheelbase))
    study.row(
        f"suspension: pitch braking at {SERVICE:g} g",
        "(m h + 4 I / r) a / (k L^2 - m g (h - r))",
        "deg",
        math.degrees(track.late(-np.arcsin(track.rotation[:, 2, 0]), 0.5)),
        expected,
        relative(expected, 0.02),
    )


def _roll(study: Study, track: Track) -> None:
    params = track.params
    lateral = track.late(track.yaw_rate, 1.0) * track.late(track.speed, 1.0)
    shift = formulas.lateral_load_transfer(params, lateral, "hubs")
    expected = math.degrees(formulas.tilt_angle(params, shift, params.track_width))
    study.row(
        f"suspension: roll cornering at {CORNERING:g} g",
        "(m h + 4 I / r) a_y / (k T^2 - m g (h - r))",
        "deg",
        math.degrees(track.late(np.arcsin(track.rotation[:, 2, 1]), 1.0)),
        expected,
        relative(expected, 0.02),
    )


def bounce_frequency(params: VehicleParameters, dt: float) -> float:
    """Damped frequency [Hz] of the standing car, kicked in its slower mode."""
    model = contact_model(params, dt, suspension=True)
    model.dof_frictionloss[:] = 0.0  # its wheels roll freely, or they would stand still
    data = mujoco.MjData(model)
    _, dofs = rigid_joints(model)
    for _ in range(round(1.0 / dt)):
        mujoco.mj_step(model, data)  # onto its contacts
    mass, com, inertia = chassis_inertial(params)
    heave, pitch = 0.05 * formulas.bounce(params)[1] / formulas.bounce(params)[1][0]
    data.qvel[dofs[2]] = heave + pitch * com[0]  # of the rear axle
    data.qvel[dofs[4]] = pitch
    for wheel, ahead in zip(WHEELS, hub_positions(params)[:, 0] - com[0], strict=True):
        data.joint(f"travel_{wheel}").qvel = -(heave - pitch * ahead)
    motion = []  # of the mode, to which the other one is orthogonal
    for _ in range(round(1.2 / dt)):
        mujoco.mj_step(model, data)
        up = data.qvel[dofs[2]] - data.qvel[dofs[4]] * com[0]
        motion.append(mass * heave * up + inertia[1] * pitch * data.qvel[dofs[4]])
    turns = np.flatnonzero(np.diff(np.sign(motion)))
    return 1.0 / (2 * dt * (turns[1] - turns[0]))

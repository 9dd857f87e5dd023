"""Stops, coasting, slopes, wheel loads, scrub torque, energy, and springs."""

import itertools
import math
from functools import partial
from typing import Any

import mujoco
import numpy as np

from carpark_mj.vehicle.mjcf import (
    STEER_STIFFNESS,
    WHEELS,
    car_model,
    chassis_inertial,
    hub_positions,
)
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from vehicle_suite import formulas
from vehicle_suite.formulas import brush_slip
from vehicle_suite.report import Study
from vehicle_suite.testbeds import (
    LEVEL,
    LOCKING,
    ContactTestbed,
    Run,
    Track,
    circle_radius,
    contact_model,
    ramp,
    rigid_joints,
)
from vehicle_suite.turns import turn_run

HEADINGS = (0.0, 30.0, 45.0, 90.0)  # degrees
SERVICE = 0.3  # g, brake force over the weight
SLOPES = (0.05, 0.20, 0.30)  # rise over run
FACING = (0.0, 45.0, 90.0, 180.0)  # degrees from uphill
PULL = 0.15  # g, drive force over the weight
FIRST, LAST = 2.0, 5.0  # s, between which the car neither pitches nor heaves
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


def slip_threshold(study: Study) -> None:
    """Tilt at which a car on locked wheels begins to slide, lengthways and sideways."""
    params = study.params
    expected = math.degrees(math.atan(params.tyre.friction))

    def tilt(time: np.ndarray) -> np.ndarray:
        fast = np.minimum(time / 10.0, 1.0) * (expected - 4.0)
        return np.radians(fast + 0.25 * np.maximum(time - 15.0, 0.0))

    ways = {"uphill": 0.0, "sideways": math.pi / 2}
    run = partial(braking, params, LOCKING, 0.0, 36.0, tilt=tilt)
    tracks = study.bed.drive([run(heading=yaw) for yaw in ways.values()])
    for facing, track in zip(ways, tracks, strict=True):
        speed = np.linalg.norm(track.qvel[:, :2], axis=1)
        speed[: track.at(15.0)] = 0.0  # settling
        row = int(np.argmax(speed > 0.01))
        angle = math.degrees(tilt(track.time[row : row + 1])[0]) if row else math.nan
        study.row(f"slip threshold, facing {facing}", angle, expected)


def scrub_torque(study: Study) -> None:
    """Torque of the steering servos that turn the wheels of a standing car."""
    params, lock = study.params, 0.3
    run = braking(params, LOCKING, 0.0, 5.0, steering=ramp(lock, 0.5, 3.0))
    (track,) = study.bed.drive([run])
    target = np.array(formulas.front_wheel_angles(params, lock))
    torque = STEER_STIFFNESS * (target - track.wheel_angles)
    scrub = formulas.scrub_torque(params)
    expected = scrub if study.tyres == "brush" else 0.0
    what = "scrub torque at standstill, a front wheel"
    study.row(what, track.late(torque.mean(1), 0.5), expected, scrub)


def energy_balance(study: Study) -> None:
    """Lost share of the drive's work while accelerating, of the motion coasting."""
    params = study.params
    pull = Run(params, LAST, speed=0.5, force=PULL * params.mass * GRAVITY)
    driven, coasting = study.bed.drive([pull, Run(params, LAST, speed=3.0)])
    work = _work(driven, driven.drive)
    rest = (work - _gained(driven) - rolling_loss(driven)) / work
    expected = slip_loss(driven, work) if study.tyres == "brush" else 0.0
    study.row("energy balance, accelerating at 0.15 g", rest, expected)
    lost = -_gained(coasting)
    rest = (lost - rolling_loss(coasting)) / lost
    study.row("energy balance, coasting from 3 m/s", rest)


def _gained(track: Track) -> float:
    """Kinetic energy [J] of all bodies, by MuJoCo's own mass matrix."""
    data = mujoco.MjData(model := car_model(track.params, track.dt, LEVEL))
    found = []
    for row in (track.at(FIRST), track.at(LAST)):
        data.qpos, data.qvel = track.qpos[row], track.qvel[row]
        mujoco.mj_forward(model, data)
        mujoco.mj_energyVel(model, data)
        found.append(float(data.energy[1]))
    return found[1] - found[0]


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
    drives = params.front_drive, 1.0 - params.front_drive
    spinning = 2 * params.wheel_inertia / params.wheel_radius**2 * acceleration
    loss = 0.0
    for still, moved, share in zip(
        formulas.axle_loads(params), (-shift, shift), drives, strict=True
    ):
        load = still + moved
        ground = share * force - params.tyre.rolling_resistance * load - spinning
        stiffness = params.tyre.slip_stiffness * still
        loss += abs(ground) * brush_slip(ground, stiffness, params.tyre.friction * load)
    early = params.mass * acceleration**2 * track.dt * (LAST - FIRST) / work
    return loss / force - early


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
    measured = bounce_frequency(params, SPRUNG.dt)
    row("bounce frequency", measured, formulas.bounce(params)[0])
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


def bounce_frequency(params: VehicleParameters, dt: float) -> float:
    """Damped frequency [Hz] of the standing car, kicked in its slower mode."""
    model = contact_model(params, dt, suspension=True)
    model.dof_frictionloss[:] = 0.0  # its wheels roll freely, or they would stand still
    data = mujoco.MjData(model)
    _, dofs = rigid_joints(model)
    for _ in range(round(1.0 / dt)):
        mujoco.mj_step(model, data)  # onto its contacts
    mass, com, inertia = chassis_inertial(params)
    _, shape = formulas.bounce(params)
    heave, pitch = 0.05 * shape / shape[0]
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

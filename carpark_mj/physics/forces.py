"""The forces of driver and tyres on a car over a substep.

All integrators use this module: the unrolled step, `mjx.step`, C MuJoCo in the `scene`
back end and in the tests. Functions are elementwise over cars of any shape.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.physics.coordinates import (
    Car,
    CarDynamics,
    CarIndex,
    Coordinates,
    pack_tyres,
    unpack_car,
)
from carpark_mj.physics.tyres import TyreForces, TyreState, WheelMotion, tyre_forces
from carpark_mj.physics.vectors import (
    Vector,
    add,
    column,
    cross,
    dot,
    to_body,
    to_world,
)
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import STEERED
from carpark_mj.vehicle.vehicle import Vehicle
from carpark_mj.vehicle.wheel import Wheel, wheels_of


class CarForces(NamedTuple):
    """Forces of tyres and driver on cars (...) over a substep.

    Attributes:
        force_w: of all tyres, world frame [N].
        moment_b: of all tyres about the body frame's origin, body frame [N m].
        aligning: torques of the tyres about the vertical, four [N m].
        spin: net torques on the spins of the wheels, four [N m].
        load: of the tyres, four [N].
    """

    force_w: Vector
    moment_b: Vector
    aligning: tuple[jax.Array, ...]
    spin: tuple[jax.Array, ...]
    load: tuple[jax.Array, ...]


class Driven(NamedTuple):
    """Result of a substep of driver and tyres for cars (...).

    Attributes:
        forces: on the car.
        steering_targets: of the front wheels' servos [rad].
        tyres: bristles of each wheel at the end of the substep.
        actuators: at the end of the substep.
    """

    forces: CarForces
    steering_targets: tuple[jax.Array, ...]
    tyres: tuple[TyreState, ...]
    actuators: drive.Actuators


def drive_car(
    vehicle: Vehicle,
    wheels: Sequence[Wheel],
    car: Car,
    controls: tuple[jax.Array, jax.Array],
    dt: float | jax.Array,
) -> Driven:
    """A substep of driver and tyres.

    Args:
        vehicle: parameters of the cars (...).
        wheels: `wheels_of(vehicle)`.
        car: at the start of the substep.
        controls: steer and pedal (...) in [-1, 1].
        dt: substep [s].
    """
    at = car.coordinates
    speed = dot(column(at.rotation, 0), at.velocity)
    turning = sum(w.drive_share * s for w, s in zip(wheels, at.spin, strict=True))
    with jax.named_scope("driver"):
        actuators, targets, brake = drive.actuate(
            vehicle, car.actuators, controls, speed, vehicle.wheel_radius * turning, dt
        )
    torques = [
        drive.WheelTorques(actuators.drive * w.drive_share, brake * w.brake_share)
        for w in wheels
    ]
    with jax.named_scope("tyres"):
        forces, tyres = roll(wheels, at, car.tyres, torques, dt)
    return Driven(forces, targets, tyres, actuators)


def roll(
    wheels: Sequence[Wheel],
    at: Coordinates,
    tyres: Sequence[TyreState],
    torques: Sequence[drive.WheelTorques],
    dt: float | jax.Array,
) -> tuple[CarForces, tuple[TyreState, ...]]:
    """Forces of the tyres on cars over one substep, for given wheel torques.

    The ground is the plane z = 0; a slope is tilted gravity (`gravity_vector`).

    Args:
        wheels: of the cars (...).
        at: positions and velocities of the cars.
        tyres: bristles of each wheel at the start of the substep.
        torques: of drive and brakes on each wheel.
        dt: substep [s].

    Returns:
        The forces, and the bristles at the end of the substep.
    """
    rotation = at.rotation
    zero = jnp.zeros_like(at.position[2])
    force_w = moment_b = (zero, zero, zero)
    rolled: list[tuple[TyreForces, TyreState]] = []
    for i, wheel in enumerate(wheels):
        motion, heading, contact = _wheel_motion(wheel, at, i)
        forces, state = tyre_forces(wheel, motion, tyres[i], torques[i], dt)
        push = (
            forces.forward * heading[0] - forces.left * heading[1],
            forces.forward * heading[1] + forces.left * heading[0],
            forces.load,
        )
        force_w = add(force_w, push)
        moment_b = add(moment_b, cross(contact, to_body(rotation, push)))
        rolled.append((forces, state))
    aligning = tuple(forces.aligning for forces, _ in rolled)
    moment_b = (moment_b[0], moment_b[1], moment_b[2] + sum(aligning))
    spin = tuple(forces.spin for forces, _ in rolled)
    load = tuple(forces.load for forces, _ in rolled)
    forces = CarForces(force_w, moment_b, aligning, spin, load)
    return forces, tuple(state for _, state in rolled)


def _wheel_motion(
    wheel: Wheel, at: Coordinates, i: int
) -> tuple[WheelMotion, tuple[jax.Array, jax.Array], Vector]:
    """Motion of the `i`-th wheel.

    Returns:
        The motion; the unit vector (x, y) along the wheel's plane on the ground; the
        contact point in the body frame [m]. That point lies on the ground and does not
        lean with the car; otherwise the centre of gravity would be too high above it
        and the car would tip over too early.
    """
    rotation = at.rotation
    up = rotation[2]
    x, y = wheel.hub
    height = at.position[2] + x * up[0] + y * up[1]  # of the undeflected wheel
    contact = (x - height * up[0], y - height * up[1], -height * up[2])
    # Velocities are those of the contact patch, where the forces act, so that tyre
    # forces do exactly the work their deflections and losses account for.
    velocity_w = add(at.velocity, to_world(rotation, cross(at.angular, contact)))
    along_x, along_y, yaw_rate = rotation[0][0], rotation[1][0], at.angular[2]
    shorter = jnp.sqrt(along_x**2 + along_y**2)
    along_x, along_y = along_x / shorter, along_y / shorter
    if i < len(STEERED):
        cos, sin = jnp.cos(at.steer[i]), jnp.sin(at.steer[i])
        along_x, along_y = along_x * cos - along_y * sin, along_y * cos + along_x * sin
        yaw_rate = yaw_rate + at.steer_rate[i]
    motion = WheelMotion(
        forward=velocity_w[0] * along_x + velocity_w[1] * along_y,
        left=velocity_w[1] * along_x - velocity_w[0] * along_y,
        yaw_rate=yaw_rate,
        spin=at.spin[i],
        sink=-height,
        sink_rate=-velocity_w[2],
    )
    return motion, (along_x, along_y), contact


def substep_forces(
    index: CarIndex,
    vehicle: Vehicle,
    car: CarDynamics,
    controls: jax.Array,
    dt: float,
) -> tuple[jax.Array, jax.Array, TyreState, drive.Actuators]:
    """Forces of driver, servos and tyres on cars over one substep, for MuJoCo.

    Args:
        index: addresses of the car in `qpos` and `qvel`.
        vehicle: parameters of the cars (...).
        car: at the start of the substep.
        controls: (..., 2) steer and pedal in [-1, 1].
        dt: substep [s].

    Returns:
        `qfrc_applied` (..., nv), servo targets `ctrl` (..., 2) [rad], and bristles
        (..., 4) and actuators at the end of the substep.
    """
    forces, targets, tyres, actuators = drive_car(
        vehicle,
        wheels_of(vehicle),
        unpack_car(index, car),
        (controls[..., 0], controls[..., 1]),
        dt,
    )
    qfrc = generalized_forces(index, forces)
    return qfrc, jnp.stack(targets, -1), pack_tyres(tyres), actuators


def generalized_forces(index: CarIndex, forces: CarForces) -> jax.Array:
    """The forces as MuJoCo's `qfrc_applied` (..., nv)."""
    qfrc = [jnp.zeros_like(forces.force_w[0])] * index.nv
    root = index.root_dof
    qfrc[root : root + 6] = [*forces.force_w, *forces.moment_b]
    for dof, torque in zip(index.steer_dof, forces.aligning, strict=False):
        qfrc[dof] = torque
    for dof, torque in zip(index.spin_dof, forces.spin, strict=True):
        qfrc[dof] = torque
    return jnp.stack(qfrc, -1)

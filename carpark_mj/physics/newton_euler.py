"""Newton-Euler equations of the car, steering and wheel spin eliminated by hand.

They equal MuJoCo's for the model of `carpark_mj.vehicle.mjcf`, term by term;
docs/physics/equations.md derives them. Knuckles and wheels are balanced about their
hinges, so the common centre of mass is fixed in the body; a wheel is symmetric about
its axle, so its angle does not enter. The equations of wheels and front corners are
solved for the rates of their momentum and steering and put into the car's, a symmetric
3 x 3 system for its angular acceleration. The steering is integrated implicitly in its
damping, as `implicitfast` does, also while the servo is at its limit.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.physics.coordinates import (
    Coordinates,
    Symmetric,
    Vector,
    add,
    cross,
    multiply,
    rotate_by,
    scale,
    solve,
    subtract,
    to_body,
    to_world,
)
from carpark_mj.physics.forces import CarForces
from carpark_mj.vehicle import mjcf
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.vehicle import Vehicle

# Bodies of the car's model, `mjcf.add_car`.
_CHASSIS, _KNUCKLES, _FRONT_WHEELS, _REAR_WHEELS = 1, (2, 4), (3, 5), (6, 7)


@struct.dataclass
class MassProperties:
    """Mass properties of cars (...)."""

    mass: jax.Array  # of the whole car [kg]
    com: Vector  # common centre of mass, body frame [m]
    # about it, of all parts that do not steer: chassis, the masses of the corners as
    # points, rear wheels without their spin [kg m^2]
    body_inertia: Symmetric
    # of each front corner, knuckle and wheel, about the wheel's (longitudinal, axle,
    # vertical) axes, without the spin [kg m^2]
    corner_inertia: tuple[Vector, Vector]
    spin_inertia: tuple[jax.Array, ...]  # of each wheel about its axle [kg m^2]


def mass_properties(vehicle: Vehicle) -> MassProperties:
    """Mass properties of cars (...) from the masses of their MuJoCo bodies."""
    masses, inertias = vehicle.body_mass, vehicle.body_inertia

    def vector(a: jax.Array, body: int) -> Vector:
        x, y, z = jnp.unstack(a[..., body, :], axis=-1)
        return x, y, z

    points = [(masses[..., _CHASSIS], vector(vehicle.body_ipos, _CHASSIS))]
    corners: list[Vector] = []
    for knuckle, wheel in zip(_KNUCKLES, _FRONT_WHEELS, strict=True):
        mass = masses[..., knuckle] + masses[..., wheel]
        points.append((mass, vector(vehicle.body_pos, knuckle)))
        tilt_x, _, tilt_z = vector(inertias, wheel)
        along, across, vertical = vector(inertias, knuckle)
        corners.append((along + tilt_x, across, vertical + tilt_z))
    points += [(masses[..., w], vector(vehicle.body_pos, w)) for w in _REAR_WHEELS]
    mass, moment = jnp.zeros_like(points[0][0]), scale(0.0, points[0][1])
    for m, at in points:
        mass, moment = mass + m, add(moment, scale(m, at))
    com = scale(1.0 / mass, moment)

    xx, yy, zz = vector(inertias, _CHASSIS)
    xy = xz = yz = jnp.zeros_like(xx)
    for wheel in _REAR_WHEELS:
        tilt_x, _, tilt_z = vector(inertias, wheel)
        xx, zz = xx + tilt_x, zz + tilt_z
    for m, at in points:
        x, y, z = subtract(at, com)
        xx, yy, zz = (
            xx + m * (y * y + z * z),
            yy + m * (x * x + z * z),
            zz + m * (x * x + y * y),
        )
        xy, xz, yz = xy - m * x * y, xz - m * x * z, yz - m * y * z

    wheels = _FRONT_WHEELS + _REAR_WHEELS
    return MassProperties(
        mass=mass,
        com=com,
        body_inertia=(xx, yy, zz, xy, xz, yz),
        corner_inertia=(corners[0], corners[1]),
        spin_inertia=tuple(inertias[..., wheel, 1] for wheel in wheels),
    )


def advance(
    masses: MassProperties,
    at: Coordinates,
    forces: CarForces,
    steering_targets: tuple[jax.Array, ...],
    gravity: Vector,
    dt: float | jax.Array,
) -> Coordinates:
    """Coordinates of cars (...) a substep of `dt` [s] later, as by `mjx.step`.

    Steering targets of the servos [rad], gravity in the world frame [m/s^2].
    """
    with jax.named_scope("newton_euler"):
        w, rotation = at.angular, at.rotation
        corners = [
            _front_corner(masses, at, forces, steering_targets[i], i, dt)
            for i in range(len(STEERED))
        ]
        inertia = masses.body_inertia
        force_b = to_body(rotation, forces.force_w)
        moment = subtract(forces.moment_b, cross(masses.com, force_b))
        moment = subtract(moment, cross(w, multiply(inertia, w)))
        for corner in corners:
            xx, yy, zz, xy, xz, yz = inertia
            c_xx, c_yy, c_zz, c_xy = corner.inertia
            inertia = (xx + c_xx, yy + c_yy, zz + c_zz, xy + c_xy, xz, yz)
            moment = subtract(moment, corner.reaction)
        for i in range(len(STEERED), len(WHEELS)):
            momentum = masses.spin_inertia[i] * (at.spin[i] + w[1])
            # dH/dt n + H w x n, the axle n along y
            reaction = (-momentum * w[2], forces.spin[i], momentum * w[0])
            moment = subtract(moment, reaction)
        turning = solve(inertia, moment)

        of_com = add(cross(turning, masses.com), cross(w, cross(w, masses.com)))
        pull = add(scale(1.0 / masses.mass, forces.force_w), gravity)
        linear = subtract(pull, to_world(rotation, of_com))
        steering = [c.free - c.yaw_share * turning[2] for c in corners]
        spinning = []
        for i in range(len(WHEELS)):
            about_axle = turning[1]
            if i < len(STEERED):
                x, y = corners[i].axle
                about_axle = x * turning[0] + y * turning[1] + corners[i].axle_turning
            spinning.append(forces.spin[i] / masses.spin_inertia[i] - about_axle)

    # Semi-implicit Euler.
    def later(now: Sequence[jax.Array], rates: Sequence[jax.Array]) -> Any:
        return tuple(x + dt * v for x, v in zip(now, rates, strict=True))

    velocity, angular = later(at.velocity, linear), later(at.angular, turning)
    steer_rate, spin = later(at.steer_rate, steering), later(at.spin, spinning)
    return Coordinates(
        position=later(at.position, velocity),
        quaternion=rotate_by(at.quaternion, angular, dt),
        steer=later(at.steer, steer_rate),
        angle=later(at.angle, spin),
        velocity=velocity,
        angular=angular,
        steer_rate=steer_rate,
        spin=spin,
    )


class _Corner(NamedTuple):
    """A front corner's part in the car's equation, its steering eliminated."""

    # xx, yy, zz, xy to add to the body's [kg m^2]
    inertia: tuple[jax.Array, jax.Array, jax.Array, jax.Array]
    # moment that the body must give it, without the body's angular acceleration [N m]
    reaction: Vector
    free: jax.Array  # acceleration of the steering if the body had none [rad/s^2]
    # how much of the body's yaw acceleration the steering lags behind
    yaw_share: jax.Array
    axle: tuple[jax.Array, jax.Array]  # (x, y) of the wheel's axle in the body frame
    # what steering adds to the angular acceleration about the axle
    axle_turning: jax.Array


def _front_corner(
    masses: MassProperties,
    at: Coordinates,
    forces: CarForces,
    target: jax.Array,
    i: int,
    dt: float | jax.Array,
) -> _Corner:
    along, across, vertical = masses.corner_inertia[i]
    cos, sin, rate = jnp.cos(at.steer[i]), jnp.sin(at.steer[i]), at.steer_rate[i]
    w = at.angular
    # Angular velocity about the corner's own axes: ahead, axle, up.
    ahead, axle, up = cos * w[0] + sin * w[1], cos * w[1] - sin * w[0], w[2] + rate
    momentum = masses.spin_inertia[i] * (at.spin[i] + axle)
    gyro_ahead = along * rate * axle + (vertical - across) * axle * up - momentum * up
    gyro_axle = (
        -across * rate * ahead + (along - vertical) * up * ahead + forces.spin[i]
    )
    gyro_up = (across - along) * ahead * axle + momentum * ahead
    servo = mjcf.STEER_STIFFNESS * (target - at.steer[i]) - mjcf.STEER_DAMPING * rate
    torque = (
        forces.aligning[i]
        + jnp.clip(servo, -mjcf.STEER_TORQUE, mjcf.STEER_TORQUE)
        - mjcf.STEER_FRICTION_DAMPING * rate
    )
    damping = mjcf.STEER_DAMPING + mjcf.STEER_FRICTION_DAMPING
    resisting = 1.0 / (vertical + mjcf.STEER_ARMATURE + dt * damping)
    free, yaw_share = (torque - gyro_up) * resisting, vertical * resisting
    return _Corner(
        inertia=(
            along * cos * cos + across * sin * sin,
            along * sin * sin + across * cos * cos,
            vertical * (1.0 - yaw_share),
            (along - across) * cos * sin,
        ),
        reaction=(
            gyro_ahead * cos - gyro_axle * sin,
            gyro_ahead * sin + gyro_axle * cos,
            gyro_up + vertical * free,
        ),
        free=free,
        yaw_share=yaw_share,
        axle=(-sin, cos),
        axle_turning=-rate * ahead,
    )

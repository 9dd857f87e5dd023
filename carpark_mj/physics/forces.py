r"""Forces on a car over a substep: gravity, brush tyres, driver.

All integrators use this module. Functions are elementwise over cars of any shape.

Sloping ground is level, and gravity tilted; on a ramp, a band of the lot, it is tilted
more. The whole car has the slope at its centre of gravity; x is along the ground.

The contact patch of a brush tyre is one bristle per direction (a transient brush model:
Fiala's steady state with relaxation). With the patch sliding at (v_x, v_y) in the wheel
plane and twisting at w_z,

    du/dt   = v_x - |v_hub| u / sigma_x,     v_x = v_hub - omega r
    dw/dt   = v_y - |v_hub| w / sigma_y
    dphi/dt = w_z - |v_hub| phi / sigma_t

    F = -(k_x u, k_y w) (1 - s/3 + s^2/27) - damping,  s = |(k_x u, k_y w)| / (mu F_z)

limited to mu F_z; s is held at 3, where the whole patch slides. k_y sigma_y is the
cornering stiffness, k_x sigma_x the slip stiffness. At standstill the bristles are
true springs: no creep, exact hold up to the friction limit. Vertically a spring and
damper per corner carries the car.

The wheel spin is integrated explicitly by MuJoCo, and dt^2 k_x r^2 / I_w is near 4 at
10 ms for an ordinary wheel, the limit of stability. The longitudinal force is
therefore computed implicitly in the spin, with brake and rolling resistance as
exact Coulomb torques, and the bristle is advanced with the spin that results.

References: Pacejka, Tyre and Vehicle Dynamics, ch. 3 (brush model) and 7 (single
contact point transient model); Fiala 1954.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import SimConfig
from carpark_mj.physics.coordinates import (
    Car,
    CarDynamics,
    CarIndex,
    Coordinates,
    Rotation,
    TyreState,
    Vector,
    add,
    column,
    cross,
    dot,
    pack_tyres,
    to_body,
    to_world,
    unpack_car,
)
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.drive import WheelTorques
from carpark_mj.vehicle.mjcf import STEERED
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import Tyres, Vehicle, Wheel, wheels_of

EASE = 3.0  # m, over which the grade of a ramp begins and ends [est]


def gravity_vector(sim: SimConfig) -> tuple[float, float, float]:
    """Gravity (3,) [m/s^2] seen from ground of the configured slope, normal to it."""
    g = GRAVITY / math.hypot(1.0, sim.grade_x)
    return (-g * sim.grade_x, 0.0, -g)


def gravity_at(sim: SimConfig, x: jax.Array) -> Vector:
    """The same [m/s^2] at places (...) along world x [m], on a ramp or off it."""
    if not sim.has_ramp:
        values = gravity_vector(sim)
        return tuple(jnp.asarray(value, x.dtype) for value in values)  # pyright: ignore
    grade = grade_at(sim, x)
    g = GRAVITY / jnp.sqrt(1.0 + grade * grade)
    return -g * grade, jnp.zeros_like(g), -g


def grade_at(sim: SimConfig, x: jax.Array) -> jax.Array:
    """Slope (...) of the ground along world x at places (...) [m], rise over run."""
    start, end, grade = sim.ramp
    within = jnp.minimum(x - start, end - x) * (1.0 / EASE) + 1.0
    return sim.grade_x + grade * jnp.clip(within, 0.0, 1.0)


_SLIDING = 3.0  # s at which the whole contact patch slides
_TINY = 1e-12
_MIN_LOAD = 1.0  # N, keeps a lifted wheel's slip finite


class WheelMotion(NamedTuple):
    """Motion of wheels (...), the input of the tyre model."""

    forward: jax.Array  # velocity of an unspun contact point along the plane [m/s]
    left: jax.Array  # velocity of the contact point left of the wheel's plane [m/s]
    yaw_rate: jax.Array  # of the wheel about the vertical [rad/s]
    spin: jax.Array  # [rad/s], forwards positive
    sink: jax.Array  # how far the hub is below its radius above the ground [m]
    sink_rate: jax.Array  # [m/s]


class TyreForces(NamedTuple):
    """Forces of tyres (...) on the car in one substep."""

    forward: jax.Array  # force on the car along the wheel's plane [N]
    left: jax.Array  # force on the car left of the wheel's plane [N]
    load: jax.Array  # force on the car upwards [N]
    aligning: jax.Array  # torque about the vertical [N m]
    spin: jax.Array  # net torque on the wheel's spin, drive and brake included [N m]


def tyre_forces(
    wheel: Wheel,
    motion: WheelMotion,
    state: TyreState,
    torques: WheelTorques,
    dt: float | jax.Array,
) -> tuple[TyreForces, TyreState]:
    """Forces of tyres over a substep of `dt` [s], and the bristles at its end.

    Elementwise, for wheels of any shape, from motion and bristles at its start.
    """
    tyre, (drive, brake) = wheel.tyre, torques
    radius, inertia = wheel.radius, wheel.inertia
    load = jnp.maximum(
        tyre.static_load
        + tyre.vertical_stiffness * motion.sink
        + tyre.vertical_damping * motion.sink_rate,
        0.0,
    )
    limit = tyre.friction * jnp.maximum(load, _MIN_LOAD)
    rolling = jnp.abs(motion.forward)

    # Bristles at the end of the substep, implicit in their decay, spin held.
    slip = motion.forward - motion.spin * radius
    decay_x = 1.0 + dt * rolling / tyre.longitudinal_relaxation
    decay_y = 1.0 + dt * rolling / tyre.lateral_relaxation
    u = (state.longitudinal + dt * slip) / decay_x
    w = (state.lateral + dt * motion.left) / decay_y
    sliding, shape, _ = _saturation(tyre, limit, u, w)
    u_rate = (u - state.longitudinal) / dt
    w_rate = (w - state.lateral) / dt
    stuck = jnp.where(sliding, 0.0, 1.0)
    force_x = -(
        tyre.longitudinal_stiffness * u * shape
        + tyre.longitudinal_damping * u_rate * stuck
    )
    force_y = -(
        tyre.lateral_stiffness * w * shape + tyre.lateral_damping * w_rate * stuck
    )

    # Implicit in the spin: the force falls by gain/dt I_w/r per unit of spin gained.
    gain = (
        (tyre.longitudinal_stiffness * shape * dt + tyre.longitudinal_damping * stuck)
        * radius**2
        * dt
        / (inertia * decay_x)
    )
    resistance = brake + tyre.rolling_resistance * load * radius
    momentum = inertia * motion.spin / dt
    stop = -(momentum * (1.0 + gain) + drive - radius * force_x)
    torque = drive + jnp.clip(stop, -resistance, resistance)
    force_x = (force_x + gain * torque / radius) / (1.0 + gain)

    # Friction circle, then the Coulomb torque that belongs to the final force.
    share = jnp.minimum(1.0, limit / jnp.sqrt(force_x**2 + force_y**2 + _TINY))
    force_x, force_y = force_x * share, force_y * share
    free = drive - radius * force_x
    spin_torque = free + jnp.clip(-(momentum + free), -resistance, resistance)

    # The bristle moves with the spin at the end of the substep.
    u = u - dt * radius * (dt * spin_torque / inertia) / decay_x
    _, _, keep = _saturation(tyre, limit, u, w)

    twist_limit = tyre.torsion_yield * load / tyre.static_load
    twist = (state.twist + dt * motion.yaw_rate) / (
        1.0 + dt * rolling / tyre.torsion_relaxation
    )
    twist = jnp.clip(twist, -twist_limit, twist_limit)
    aligning = -tyre.torsion_stiffness * twist
    forces = TyreForces(force_x, force_y, load, aligning, spin_torque)
    return forces, TyreState(longitudinal=u * keep, lateral=w * keep, twist=twist)


def _saturation(
    tyre: Tyres, limit: jax.Array, u: jax.Array, w: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sliding flag, brush shape factor F / (k u), and the scale that caps bristles."""
    stretch = (tyre.longitudinal_stiffness * u) ** 2 + (tyre.lateral_stiffness * w) ** 2
    s = jnp.sqrt(stretch + _TINY) / limit
    capped = jnp.minimum(s, _SLIDING)
    keep = capped / s
    shape = (1.0 - capped / 3.0 + capped**2 / 27.0) * keep
    return s > _SLIDING, shape, keep


class CarForces(NamedTuple):
    """Forces of tyres and driver on cars (...) over a substep."""

    force_w: Vector  # of all tyres, world frame [N]
    moment_b: Vector  # of all tyres about the body frame's origin, body frame [N m]
    aligning: tuple[jax.Array, ...]  # torques about the vertical, four [N m]
    spin: tuple[jax.Array, ...]  # net torques on the spins of the wheels, four [N m]
    load: tuple[jax.Array, ...]  # of the tyres, four [N]


def drive_car(
    vehicle: Vehicle,
    wheels: Sequence[Wheel],
    car: Car,
    controls: tuple[jax.Array, jax.Array],
    dt: float | jax.Array,
) -> tuple[CarForces, tuple[jax.Array, ...], tuple[TyreState, ...], drive.Actuators]:
    """A substep of `dt` [s] of driver and tyres under steer and pedal in [-1, 1].

    Returns:
        Forces on cars (...), targets of the front wheels' servos [rad], and bristles of
        each wheel and actuators at the end.
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
    return forces, targets, tyres, actuators


def roll(
    wheels: Sequence[Wheel],
    at: Coordinates,
    tyres: Sequence[TyreState],
    torques: Sequence[drive.WheelTorques],
    dt: float | jax.Array,
) -> tuple[CarForces, tuple[TyreState, ...]]:
    """Forces of the tyres on cars over a substep, and the bristles at its end.

    The ground is the plane z = 0; a slope is tilted gravity (`gravity_vector`).
    """
    rotation = at.rotation
    zero = jnp.zeros_like(at.position[2])
    force_w = moment_b = (zero, zero, zero)
    rolled: list[tuple[TyreForces, TyreState]] = []
    for i, wheel in enumerate(wheels):
        motion, heading, contact = _wheel_motion(wheel, at, rotation, i)
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
    wheel: Wheel, at: Coordinates, rotation: Rotation, i: int
) -> tuple[WheelMotion, tuple[jax.Array, jax.Array], Vector]:
    """Motion of the `i`-th wheel, its heading (x, y), its contact point (body) [m]."""
    # The point lies on the ground and does not lean with the car; otherwise the centre
    # of gravity would be too high above it and the car would tip over too early.
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
    index: CarIndex, vehicle: Vehicle, car: CarDynamics, controls: jax.Array, dt: float
) -> tuple[jax.Array, jax.Array, TyreState, drive.Actuators]:
    """Forces of driver, servos and tyres on cars (...) over one substep, for MuJoCo.

    Returns:
        `qfrc_applied` (..., nv), servo targets `ctrl` (..., 2) [rad], and bristles
        (..., 4) and actuators at the end of the substep of `dt` [s].
    """
    pedals, wheels = (controls[..., 0], controls[..., 1]), wheels_of(vehicle)
    forces, targets, tyres, actuators = drive_car(
        vehicle, wheels, unpack_car(index, car), pedals, dt
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

"""One car's forces: what driver, servos and tyres apply over a substep.

Pure functions of `qpos` and `qvel`, for any integrator: MJX, C MuJoCo in the
`scene` back end, or the tests' oracle.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.geometry import wrap_angle
from carpark_mj.physics.tyres import TyreForces, TyreState, WheelMotion, tyre_forces
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import Vehicle


def gravity_vector(sim: SimConfig) -> tuple[float, float, float]:
    """Gravity (3,) [m/s^2] seen from ground of the configured slope, normal to it."""
    normal = math.sqrt(1.0 + sim.grade_x**2 + sim.grade_y**2)
    g = GRAVITY / normal
    return (-g * sim.grade_x, -g * sim.grade_y, -g)


class CarIndex:
    """Addresses of a car's joints in a model, looked up by name once."""

    def __init__(self, model: mujoco.MjModel, prefix: str = "") -> None:
        """Looks the joints of the car with a name prefix up."""

        def joints(kind: str, names: tuple[str, ...]) -> np.ndarray:
            return np.array([model.joint(f"{prefix}{kind}_{n}").id for n in names])

        root = model.joint(f"{prefix}root").id
        steer, spin = joints("steer", STEERED), joints("spin", WHEELS)
        self.root_qpos = int(model.jnt_qposadr[root])
        self.root_dof = int(model.jnt_dofadr[root])
        self.steer_qpos, self.steer_dof = (
            model.jnt_qposadr[steer],
            model.jnt_dofadr[steer],
        )
        self.spin_qpos, self.spin_dof = model.jnt_qposadr[spin], model.jnt_dofadr[spin]


class CarDynamics(NamedTuple):
    """What a substep changes of one car.

    Attributes:
        qpos: (nq,) MuJoCo positions.
        qvel: (nv,) MuJoCo velocities.
        tyres: bristle deflections.
        actuators: state of steering and drive.
    """

    qpos: jax.Array
    qvel: jax.Array
    tyres: TyreState
    actuators: drive.Actuators


def substep_forces(
    index: CarIndex,
    vehicle: Vehicle,
    car: CarDynamics,
    controls: jax.Array,
    dt: float,
) -> tuple[jax.Array, jax.Array, TyreState, drive.Actuators]:
    """What one car's driver, servos and tyres apply over one substep.

    The same code serves MJX and, as the tests' oracle, plain `mujoco.mj_step`.

    Args:
        index: addresses of the car in `qpos` and `qvel`.
        vehicle: its parameters.
        car: at the start of the substep.
        controls: (2,) steer and pedal in [-1, 1].
        dt: substep [s].

    Returns:
        `qfrc_applied` (nv,), servo targets `ctrl` (2,) [rad], and bristles and
        actuators at the end of the substep.
    """
    qpos, qvel, tyres, actuators = car
    rotation = rotation_matrix(qpos[index.root_qpos + 3 : index.root_qpos + 7])
    speed = rotation[:, 0] @ qvel[index.root_dof : index.root_dof + 3]
    actuators, ctrl, torques = drive.actuate(
        vehicle, actuators, controls, speed, qvel[index.spin_dof], dt
    )
    qfrc, _, tyres = apply_torques(index, vehicle, qpos, qvel, tyres, torques, dt)
    return qfrc, ctrl, tyres, actuators


def apply_torques(
    index: CarIndex,
    vehicle: Vehicle,
    qpos: jax.Array,
    qvel: jax.Array,
    tyres: TyreState,
    torques: drive.WheelTorques,
    dt: float | jax.Array,
) -> tuple[jax.Array, TyreForces, TyreState]:
    """What the tyres apply to one car over one substep, its wheel torques given.

    The ground is the plane z = 0; a slope is tilted gravity (`gravity_vector`).

    Args:
        index: addresses of the car in `qpos` and `qvel`.
        vehicle: its parameters.
        qpos: (nq,) positions.
        qvel: (nv,) velocities.
        tyres: bristles at the start of the substep.
        torques: of drive and brakes.
        dt: substep [s].

    Returns:
        `qfrc_applied` (nv,), the tyre forces in it, and the bristles at the end.
    """
    rotation = rotation_matrix(qpos[index.root_qpos + 3 : index.root_qpos + 7])
    motion, contact = _wheel_motion(index, vehicle, qpos, qvel, rotation)
    forces, tyres = tyre_forces(vehicle, motion, tyres, torques, dt)
    force_b = forces.force_w @ rotation
    moment_b = jnp.sum(jnp.cross(contact, force_b), axis=0)
    moment_b = moment_b + jnp.array([0.0, 0.0, 1.0]) * jnp.sum(forces.aligning)
    qfrc = jnp.zeros_like(qvel)
    force_w = jnp.sum(forces.force_w, axis=0)
    qfrc = qfrc.at[index.root_dof : index.root_dof + 3].set(force_w)
    qfrc = qfrc.at[index.root_dof + 3 : index.root_dof + 6].set(moment_b)
    qfrc = qfrc.at[index.steer_dof].set(forces.aligning[:2])
    qfrc = qfrc.at[index.spin_dof].set(forces.spin)
    return qfrc, forces, tyres


def _wheel_motion(
    index: CarIndex,
    vehicle: Vehicle,
    qpos: jax.Array,
    qvel: jax.Array,
    rotation: jax.Array,
) -> tuple[WheelMotion, jax.Array]:
    """Kinematics of the wheels, and their contact points; see `_contacts`."""
    linear_b = rotation.T @ qvel[index.root_dof : index.root_dof + 3]
    angular_b = qvel[index.root_dof + 3 : index.root_dof + 6]
    contact, height = _contacts(index, vehicle, qpos, rotation)
    # Velocities are those of the contact patch, where the forces act, so that tyre
    # forces do exactly the work their deflections and losses account for.
    velocity_w = (linear_b + jnp.cross(angular_b, contact)) @ rotation.T
    forward_w = rotation[:, 0]
    steer = jnp.pad(qpos[index.steer_qpos], (0, 2))
    steer_rate = jnp.pad(qvel[index.steer_dof], (0, 2))
    heading = forward_w[:2]
    heading = heading / jnp.sqrt(jnp.sum(heading**2, axis=-1, keepdims=True))
    cos, sin = jnp.cos(steer), jnp.sin(steer)
    along_x = heading[0] * cos - heading[1] * sin
    along_y = heading[1] * cos + heading[0] * sin
    forward = velocity_w[:, 0] * along_x + velocity_w[:, 1] * along_y
    left = velocity_w[:, 1] * along_x - velocity_w[:, 0] * along_y
    motion = WheelMotion(
        heading_w=jnp.stack([along_x, along_y], axis=-1),
        velocity=jnp.stack([forward, left], axis=-1),
        yaw_rate=angular_b[2] + steer_rate,
        spin=qvel[index.spin_dof],
        sink=-height,
        sink_rate=-velocity_w[:, 2],
    )
    return motion, contact


def _contacts(
    index: CarIndex, vehicle: Vehicle, qpos: jax.Array, rotation: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Where the tyres meet the ground.

    Returns:
        Contact points (4, 3) in the body frame [m], on the ground: they do not lean
        with the car, or its centre of gravity would stand too high above them and it
        would tip over too early. How far (4,) the undeflected wheels are above the
        ground [m].
    """
    undeflected = jnp.pad(vehicle.hub, ((0, 0), (0, 1)))
    height = qpos[index.root_qpos + 2] + undeflected @ rotation[2]
    return undeflected - height[:, None] * rotation[2], height


def rotation_matrix(quat: jax.Array) -> jax.Array:
    """Rotation matrix (3, 3), body to world, of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    return jnp.stack(
        [
            jnp.stack(
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]
            ),
            jnp.stack(
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]
            ),
            jnp.stack(
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]
            ),
        ]
    )


def centre_pose(qpos: jax.Array, vehicle: Vehicle) -> jax.Array:
    """Pose (3,) of the footprint's centre from one car's `qpos`."""
    w, x, y, z = qpos[3], qpos[4], qpos[5], qpos[6]
    yaw = jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    return jnp.stack(
        [
            qpos[0] + vehicle.centre_offset * jnp.cos(yaw),
            qpos[1] + vehicle.centre_offset * jnp.sin(yaw),
            wrap_angle(yaw),
        ]
    )

"""The state of a car's MuJoCo model, packed as in MuJoCo and unpacked by name."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from carpark_mj.geometry import wrap_angle
from carpark_mj.physics.tyres import TyreState
from carpark_mj.physics.vectors import Quaternion, Rotation, Vector, rotation
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.vehicle import Vehicle


class CarIndex:
    """Addresses of a car's joints in a model, looked up by name once.

    Attributes:
        root_qpos, root_dof: first of the free joint's in `qpos` and `qvel`.
        steer_qpos, steer_dof: (2,) of the steered wheels.
        spin_qpos, spin_dof: (4,) of the wheels.
        nv: degrees of freedom of the model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """Looks up the joints of the model's car."""

        def addresses(table: str, kind: str, names: tuple[str, ...]) -> np.ndarray:
            joints = [model.joint(f"{kind}_{n}").id for n in names]
            return getattr(model, table)[joints]

        root = model.joint("root").id
        self.root_qpos = int(model.jnt_qposadr[root])
        self.root_dof = int(model.jnt_dofadr[root])
        self.steer_qpos = addresses("jnt_qposadr", "steer", STEERED)
        self.steer_dof = addresses("jnt_dofadr", "steer", STEERED)
        self.spin_qpos = addresses("jnt_qposadr", "spin", WHEELS)
        self.spin_dof = addresses("jnt_dofadr", "spin", WHEELS)
        self.nv = model.nv


class CarDynamics(NamedTuple):
    """Variables of cars (...) that a substep changes, packed.

    Attributes:
        qpos: (..., nq) MuJoCo positions.
        qvel: (..., nv) MuJoCo velocities.
        tyres: bristle deflections (..., 4).
        actuators: state of steering and drive.
    """

    qpos: jax.Array
    qvel: jax.Array
    tyres: TyreState
    actuators: drive.Actuators


class Coordinates(NamedTuple):
    """Positions and velocities of cars (...), an array (...) per component.

    Attributes:
        position: of the body frame's origin, world frame [m].
        quaternion: orientation (w, x, y, z), body to world.
        steer: angles of the front wheels, left positive [rad].
        angle: of the four wheels about their axles [rad].
        velocity: of the origin, world frame [m/s].
        angular: angular velocity, body frame [rad/s].
        steer_rate: of the front wheels [rad/s].
        spin: of the four wheels relative to the car, forwards positive [rad/s].
    """

    position: Vector
    quaternion: Quaternion
    steer: tuple[jax.Array, ...]
    angle: tuple[jax.Array, ...]
    velocity: Vector
    angular: Vector
    steer_rate: tuple[jax.Array, ...]
    spin: tuple[jax.Array, ...]

    @property
    def rotation(self) -> Rotation:
        """Rotation matrix, body to world."""
        return rotation(self.quaternion)


class Car(NamedTuple):
    """Variables of cars (...) that a substep changes: an array (...) per component.

    Attributes:
        coordinates: positions and velocities.
        tyres: bristle deflections of each wheel.
        actuators: state of steering and drive.
    """

    coordinates: Coordinates
    tyres: tuple[TyreState, ...]
    actuators: drive.Actuators


def unpack_coordinates(
    index: CarIndex, qpos: jax.Array, qvel: jax.Array
) -> Coordinates:
    """Coordinates of cars from MuJoCo's `qpos` (..., nq) and `qvel` (..., nv)."""
    q = [qpos[..., i] for i in range(qpos.shape[-1])]
    v = [qvel[..., i] for i in range(qvel.shape[-1])]
    at, dof = index.root_qpos, index.root_dof
    return Coordinates(
        position=(q[at], q[at + 1], q[at + 2]),
        quaternion=(q[at + 3], q[at + 4], q[at + 5], q[at + 6]),
        steer=tuple(q[i] for i in index.steer_qpos),
        angle=tuple(q[i] for i in index.spin_qpos),
        velocity=(v[dof], v[dof + 1], v[dof + 2]),
        angular=(v[dof + 3], v[dof + 4], v[dof + 5]),
        steer_rate=tuple(v[i] for i in index.steer_dof),
        spin=tuple(v[i] for i in index.spin_dof),
    )


def unpack_car(index: CarIndex, car: CarDynamics) -> Car:
    """Cars unpacked."""
    return Car(
        unpack_coordinates(index, car.qpos, car.qvel),
        unpack_tyres(car.tyres),
        car.actuators,
    )


def pack_car(index: CarIndex, car: Car) -> CarDynamics:
    """Cars packed; the model must have the car's 12 degrees of freedom only."""
    qpos, qvel = pack_coordinates(index, car.coordinates)
    return CarDynamics(qpos, qvel, pack_tyres(car.tyres), car.actuators)


def pack_coordinates(index: CarIndex, at: Coordinates) -> tuple[jax.Array, jax.Array]:
    """MuJoCo's positions (..., 13) and velocities (..., 12) of cars."""
    q = dict(zip(index.steer_qpos, at.steer, strict=True))
    q |= zip(index.spin_qpos, at.angle, strict=True)
    v = dict(zip(index.steer_dof, at.steer_rate, strict=True))
    v |= zip(index.spin_dof, at.spin, strict=True)
    return (
        jnp.stack([*at.position, *at.quaternion, *(q[i] for i in sorted(q))], -1),
        jnp.stack([*at.velocity, *at.angular, *(v[i] for i in sorted(v))], -1),
    )


def unpack_tyres(tyres: TyreState) -> tuple[TyreState, ...]:
    """Bristles (..., 4) of cars as those (...) of each wheel."""
    return tuple(
        jax.tree.map(lambda x, i=i: x[..., i], tyres) for i in range(len(WHEELS))
    )


def pack_tyres(tyres: tuple[TyreState, ...]) -> TyreState:
    """Bristles (...) of each wheel as those (..., 4) of cars."""
    return jax.tree.map(lambda *x: jnp.stack(x, -1), *tyres)


def centre_pose(at: Coordinates, vehicle: Vehicle) -> jax.Array:
    """Poses (..., 3) of the footprints' centres of cars (...)."""
    return jnp.stack(unpacked_centre_pose(at, vehicle), axis=-1)


def unpacked_centre_pose(at: Coordinates, vehicle: Vehicle) -> Vector:
    """`centre_pose` as x, y and yaw (...)."""
    w, x, y, z = at.quaternion
    yaw = jnp.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
    centre_x = at.position[0] + vehicle.centre_offset * jnp.cos(yaw)
    centre_y = at.position[1] + vehicle.centre_offset * jnp.sin(yaw)
    return centre_x, centre_y, wrap_angle(yaw)

"""The state of a car's MuJoCo model, packed as in MuJoCo and unpacked by name.

Unpacked, vectors, rotations and quaternions are tuples of arrays, one array per
component of the batch's shape. So a substep is elementwise from end to end, and XLA
fuses it into a few loops; small matrices would cost a kernel for each product.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from flax import struct

from carpark_mj.geometry import wrap_angle
from carpark_mj.vehicle import drive
from carpark_mj.vehicle.mjcf import STEERED, WHEELS
from carpark_mj.vehicle.vehicle import Vehicle

Vector = tuple[jax.Array, jax.Array, jax.Array]
Quaternion = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
Rotation = tuple[Vector, Vector, Vector]  # rows
# Of a symmetric matrix: xx, yy, zz, xy, xz, yz.
Symmetric = tuple[jax.Array, jax.Array, jax.Array, jax.Array, jax.Array, jax.Array]

_REST = 1e-20  # (rad/s)^2, what is slower turns by nothing that float32 could tell


def add(a: Vector, b: Vector) -> Vector:
    """A + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector, b: Vector) -> Vector:
    """A - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(factor: jax.Array | float, a: Vector) -> Vector:
    """Factor * a."""
    return factor * a[0], factor * a[1], factor * a[2]


def dot(a: Vector, b: Vector) -> jax.Array:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def column(r: Rotation, k: int) -> Vector:
    """Body axis `k` in the world frame."""
    return r[0][k], r[1][k], r[2][k]


def to_world(r: Rotation, a: Vector) -> Vector:
    """A vector of the body frame in the world frame."""
    return dot(r[0], a), dot(r[1], a), dot(r[2], a)


def to_body(r: Rotation, a: Vector) -> Vector:
    """A vector of the world frame in the body frame."""
    return dot(column(r, 0), a), dot(column(r, 1), a), dot(column(r, 2), a)


def multiply(m: Symmetric, a: Vector) -> Vector:
    """Symmetric matrix times vector."""
    xx, yy, zz, xy, xz, yz = m
    return dot((xx, xy, xz), a), dot((xy, yy, yz), a), dot((xz, yz, zz), a)


def solve(m: Symmetric, b: Vector) -> Vector:
    """Solves m x = b for a symmetric positive definite matrix, by its adjugate."""
    xx, yy, zz, xy, xz, yz = m
    first = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    second = first[1], xx * zz - xz * xz, xy * xz - xx * yz
    third = first[2], second[2], xx * yy - xy * xy
    # Divided last: XLA computes quotients once, but products anew for each of their
    # uses, and all of a car's accelerations use these.
    det = dot((xx, xy, xz), first)
    return dot(first, b) / det, dot(second, b) / det, dot(third, b) / det


def rotate_by(q: Quaternion, angular: Vector, dt: float | jax.Array) -> Quaternion:
    """The orientation after turning at `angular` (body frame) [rad/s] for `dt` [s].

    As MuJoCo integrates: q exp(dt angular / 2), normalised.
    """
    square = dot(angular, angular)
    # At rest not 0, or the gradient would say that a body at rest cannot be turned.
    rate = jnp.sqrt(jnp.maximum(square, _REST))
    half = 0.5 * dt * rate
    c, (x, y, z) = jnp.cos(half), scale(jnp.sin(half) / rate, angular)
    w0, x0, y0, z0 = q
    turned = (
        w0 * c - x0 * x - y0 * y - z0 * z,
        w0 * x + x0 * c + y0 * z - z0 * y,
        w0 * y - x0 * z + y0 * c + z0 * x,
        w0 * z + x0 * y - y0 * x + z0 * c,
    )
    w1, x1, y1, z1 = turned
    length = jnp.sqrt(w1 * w1 + x1 * x1 + y1 * y1 + z1 * z1)
    return w1 / length, x1 / length, y1 / length, z1 / length


class CarIndex:
    """Addresses of a car's joints in `qpos` and `qvel`, looked up by name once."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Looks up the joints of the model's car."""

        def addresses(table: str, kind: str, names: tuple[str, ...]) -> np.ndarray:
            joints = [model.joint(f"{kind}_{n}").id for n in names]
            return getattr(model, table)[joints]

        root = model.joint("root").id  # its first of seven and six
        self.root_qpos = int(model.jnt_qposadr[root])
        self.root_dof = int(model.jnt_dofadr[root])
        self.steer_qpos = addresses("jnt_qposadr", "steer", STEERED)
        self.steer_dof = addresses("jnt_dofadr", "steer", STEERED)
        self.spin_qpos = addresses("jnt_qposadr", "spin", WHEELS)
        self.spin_dof = addresses("jnt_dofadr", "spin", WHEELS)
        self.nv = model.nv


@struct.dataclass
class TyreState:
    """Bristle deflections of wheels; any shape, in `CarState` (..., 4)."""

    longitudinal: jax.Array  # u [m]
    lateral: jax.Array  # w [m]
    twist: jax.Array  # phi [rad]


def init_tyres(*lead: int, dtype: jnp.dtype | None = None) -> TyreState:
    """Relaxed tyres (..., 4) of cars."""
    zero = jnp.zeros((*lead, 4), dtype)
    return TyreState(longitudinal=zero, lateral=zero, twist=zero)


class CarDynamics(NamedTuple):
    """Variables of cars (...) that a substep changes, packed."""

    qpos: jax.Array  # (..., nq) MuJoCo positions
    qvel: jax.Array  # (..., nv) MuJoCo velocities
    tyres: TyreState  # bristle deflections (..., 4)
    actuators: drive.Actuators  # state of steering and drive


class Coordinates(NamedTuple):
    """Positions and velocities of cars (...), an array (...) per component."""

    position: Vector  # of the body frame's origin, world frame [m]
    quaternion: Quaternion  # orientation (w, x, y, z), body to world
    steer: tuple[jax.Array, ...]  # angles of the front wheels, left positive [rad]
    angle: tuple[jax.Array, ...]  # of the four wheels about their axles [rad]
    velocity: Vector  # of the origin, world frame [m/s]
    angular: Vector  # angular velocity, body frame [rad/s]
    steer_rate: tuple[jax.Array, ...]  # of the front wheels [rad/s]
    # of the four wheels relative to the car, forwards positive [rad/s]
    spin: tuple[jax.Array, ...]

    @property
    def rotation(self) -> Rotation:
        """Rotation matrix, body to world."""
        w, x, y, z = self.quaternion
        xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
        wx, wy, wz = w * x, w * y, w * z
        return (
            (1 - 2 * (yy + zz), 2 * (xy - wz), 2 * (xz + wy)),
            (2 * (xy + wz), 1 - 2 * (xx + zz), 2 * (yz - wx)),
            (2 * (xz - wy), 2 * (yz + wx), 1 - 2 * (xx + yy)),
        )


class Car(NamedTuple):
    """Variables of cars (...) that a substep changes: an array (...) per component."""

    coordinates: Coordinates  # positions and velocities
    tyres: tuple[TyreState, ...]  # bristle deflections of each wheel
    actuators: drive.Actuators  # state of steering and drive


def unpack_coordinates(
    index: CarIndex, qpos: jax.Array, qvel: jax.Array
) -> Coordinates:
    """Coordinates of cars from MuJoCo's `qpos` (..., nq) and `qvel` (..., nv)."""
    q, v = jnp.unstack(qpos, axis=-1), jnp.unstack(qvel, axis=-1)
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


def pack_coordinates(index: CarIndex, at: Coordinates) -> tuple[jax.Array, jax.Array]:
    """MuJoCo's positions (..., 13) and velocities (..., 12) of cars alone."""
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
    columns = (jnp.unstack(x, axis=-1) for x in jax.tree.leaves(tyres))
    return tuple(TyreState(*wheel) for wheel in zip(*columns, strict=True))


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

"""Vectors, rotations and quaternions as tuples of arrays, one array per component.

The physics of a car is written on them: every component is an array of the batch's
shape, so a substep is elementwise from end to end and XLA fuses it into a few loops.
Small matrices would cost a kernel for each product.
"""

import jax
import jax.numpy as jnp

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


def rotation(q: Quaternion) -> Rotation:
    """Rotation matrix, body to world, of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
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
    inverse = 1.0 / dot((xx, xy, xz), first)
    return scale(inverse, (dot(first, b), dot(second, b), dot(third, b)))


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

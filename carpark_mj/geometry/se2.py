"""Poses in the plane, SE(2), and gradients where `jax.grad` fails or gives NaN.

A pose is `(x [m], y [m], yaw [rad])`, yaw counter-clockwise from +x. Every function
broadcasts over leading dimensions.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

Tree = TypeVar("Tree")


def with_gradient(
    function: Callable[..., Tree], like: Callable[..., Tree]
) -> Callable[..., Tree]:
    """The function with the gradients of an equal one: some loops have none."""
    wrapped = jax.custom_jvp(function)
    wrapped.defjvp(lambda args, tangents: jax.jvp(like, args, tangents))
    return wrapped


def finite_slope(function: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
    """The function, elementwise, with non-finite derivatives replaced by 0.

    The square root of 0 has an infinite slope. Where such a value is masked out, like
    the distance of a car to itself, the chain rule gives NaN: 0 times infinity.
    `jnp.abs` at 0 is alike. The values are those of the function, bit for bit.
    """

    @jax.custom_jvp
    def wrapped(*args: jax.Array) -> jax.Array:
        return function(*args)

    @wrapped.defjvp
    def _(args: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
        gained = []
        for own, tangent in enumerate(tangents):
            towards = tuple(jnp.full_like(x, i == own) for i, x in enumerate(args))
            slope = jax.jvp(function, args, towards)[1]
            gained.append(jnp.where(jnp.isfinite(slope), slope, 0.0) * tangent)
        return wrapped(*args), sum(gained[1:], gained[0])

    return wrapped


sqrt = finite_slope(jnp.sqrt)
arctan2 = finite_slope(jnp.arctan2)
arcsin = finite_slope(jnp.arcsin)
arccos = finite_slope(jnp.arccos)


def wrap_angle(angle: jax.Array) -> jax.Array:
    """Wraps angles [rad] of any shape to [-pi, pi)."""
    # `jnp.mod`, bit for bit, with half of its operations.
    turned = jnp.fmod(angle + jnp.pi, 2 * jnp.pi)
    return jnp.where(turned < 0.0, turned + 2 * jnp.pi, turned) - jnp.pi


def norm(vector: jax.Array) -> jax.Array:
    """Lengths (...) of vectors (..., 2).

    By coordinates: XLA joins this to what comes next, but not a sum along an axis,
    which costs a kernel of its own on a GPU and a slow loop on a CPU.
    """
    x, y = jnp.unstack(vector, axis=-1)
    return sqrt(x * x + y * y)


def rotate(vector: jax.Array, yaw: jax.Array) -> jax.Array:
    """Rotates vectors (..., 2) counter-clockwise by yaw (...) [rad]."""
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    x, y = jnp.unstack(vector, axis=-1)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def move_forward(pose: jax.Array, distance: jax.Array | float) -> jax.Array:
    """Moves poses (..., 3) along their headings by distances (...) [m]."""
    x, y, yaw = jnp.unstack(pose, axis=-1)
    x, y = x + distance * jnp.cos(yaw), y + distance * jnp.sin(yaw)
    return jnp.stack([x, y, yaw], axis=-1)


def to_local(frame: jax.Array, pose: jax.Array) -> jax.Array:
    """Expresses world poses (..., 3) in the frame of other poses (..., 3)."""
    frame_x, frame_y, frame_yaw = jnp.unstack(frame, axis=-1)
    x, y, yaw = jnp.unstack(pose, axis=-1)
    x, y, cos, sin = x - frame_x, y - frame_y, jnp.cos(frame_yaw), jnp.sin(frame_yaw)
    yaw = wrap_angle(yaw - frame_yaw)
    return jnp.stack([cos * x + sin * y, cos * y - sin * x, yaw], axis=-1)


def to_world(frame: jax.Array, pose: jax.Array) -> jax.Array:
    """Maps poses (..., 3) given in the frame of other poses (..., 3) to the world."""
    frame_x, frame_y, frame_yaw = jnp.unstack(frame, axis=-1)
    x, y, yaw = jnp.unstack(pose, axis=-1)
    cos, sin, yaw = jnp.cos(frame_yaw), jnp.sin(frame_yaw), wrap_angle(yaw + frame_yaw)
    x, y = frame_x + (cos * x - sin * y), frame_y + (sin * x + cos * y)
    return jnp.stack([x, y, yaw], axis=-1)


def axis_angle_error(yaw: jax.Array) -> jax.Array:
    """Angle [rad] in [0, pi/2] between undirected axes: nose in or out is alike."""
    return jnp.abs(wrap_angle(2.0 * yaw)) / 2.0


def heading_error(turn: jax.Array, one_way: jax.Array | None) -> jax.Array:
    """Angle [rad] by which headings are off, given their differences (...) [rad].

    `one_way` (...) says whether the opposite heading is wrong: then it is in [0, pi],
    otherwise that of the axes; None = nowhere.
    """
    along = axis_angle_error(turn)
    if one_way is None:
        return along
    return jnp.where(one_way, jnp.abs(wrap_angle(turn)), along)


def nearest(
    own_xy: jax.Array, xy: jax.Array, mask: jax.Array, count: int
) -> tuple[jax.Array, jax.Array]:
    """Indices (num_agents, count) of the nearest points, nearest first.

    Observers are (num_agents, 2), candidates (n, 2), those that count a mask
    (num_agents, n). Where there are fewer, indices are padded: also returns whether
    each is present.
    """
    distance = jnp.where(mask, norm(own_xy[:, None] - xy), jnp.inf)
    missing = max(count - distance.shape[1], 0)
    distance = jnp.pad(distance, ((0, 0), (0, missing)), constant_values=jnp.inf)
    # A few rounds of argmin are cheaper than sorting when few cars are tracked.
    indices, present = [], []
    columns = jnp.arange(distance.shape[1])
    for _ in range(count):
        index = jnp.argmin(distance, axis=1)
        present.append(jnp.isfinite(jnp.min(distance, axis=1)))
        indices.append(jnp.minimum(index, max(xy.shape[0] - 1, 0)))
        distance = jnp.where(columns == index[:, None], jnp.inf, distance)
    return jnp.stack(indices, axis=1), jnp.stack(present, axis=1)

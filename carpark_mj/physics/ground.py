"""The ground as a function: height and normal under a point.

The default ground is a plane, simulated as z = 0 under tilted gravity
(`SimConfig.grade_x`, `grade_y`); it costs nothing. A function here may be any surface
that is smooth on the scale of a tyre's contact patch: ramps, crowns, drains. Each tyre
then works in the plane that touches the ground below it.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.scipy.spatial.transform import Rotation

# From points (n, 2) to heights (n,) [m] and unit normals (n, 3), world frame.
Ground = Callable[[jax.Array], tuple[jax.Array, jax.Array]]


def from_height(height: Callable[[jax.Array], jax.Array]) -> Ground:
    """The ground of a height function from a point (2,) to () [m]; differentiable."""

    def ground(xy: jax.Array) -> tuple[jax.Array, jax.Array]:
        z, slope = jax.vmap(jax.value_and_grad(height))(xy)
        normal = jnp.concatenate([-slope, jnp.ones_like(slope[:, :1])], axis=-1)
        return z, normal / jnp.linalg.norm(normal, axis=-1, keepdims=True)

    return ground


def plane(grade_x: float, grade_y: float) -> Ground:
    """An even slope through the origin; grades are rise over run."""
    return from_height(lambda xy: grade_x * xy[0] + grade_y * xy[1])


def ground_frames(normal: jax.Array) -> jax.Array:
    """Rotations (n, 3, 3) that tilt the vertical to the normals (n, 3), without yaw."""
    a, b, c = normal[:, 0], normal[:, 1], normal[:, 2]
    k = 1.0 / (1.0 + c)
    return jnp.stack(
        [
            jnp.stack([1.0 - k * a * a, -k * a * b, a], axis=-1),
            jnp.stack([-k * a * b, 1.0 - k * b * b, b], axis=-1),
            jnp.stack([-a, -b, c], axis=-1),
        ],
        axis=-2,
    )


def upright(normal: jax.Array, yaw: jax.Array) -> jax.Array:
    """Quaternion (4,) (w, x, y, z) of a car on a slope; `yaw` [rad] as seen from above.

    Args:
        normal: (3,) of the ground.
        yaw: () heading of the car's axis in plan.
    """
    flat = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)])
    ahead = jnp.append(flat, -(flat @ normal[:2]) / normal[2])
    ahead = ahead / jnp.linalg.norm(ahead)
    axes = jnp.stack([ahead, jnp.cross(normal, ahead), normal], axis=-1)
    return Rotation.from_matrix(axes).as_quat()[jnp.array([3, 0, 1, 2])]

"""What the cameras of all cars of a lot see: depth, what it is, and how bright."""

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.cameras.blocks import Heights, lot_blocks
from carpark_mj.cameras.faults import Faults, is_dirty
from carpark_mj.cameras.ground import (
    GRASS,
    HEIGHTS,
    LINE,
    SHOWS,
    Place,
    cover,
    is_grass,
)
from carpark_mj.cameras.hits import SHADES, decode, encode, sky_hit
from carpark_mj.cameras.rig import Rig, Seen
from carpark_mj.cameras.trace import AMBIENT, DIFFUSE, SUN, seat, trace
from carpark_mj.geometry.se2 import rotate
from carpark_mj.types import State

_SKY = sky_hit(int(Seen.SKY))
_LEAST_DROP = 1e-6  # of a ray that meets the ground
_BRIGHT = round(SHADES * (AMBIENT + DIFFUSE * SUN[2]))  # of what lies flat


@struct.dataclass
class Pictures:
    """Pictures of the cameras of cars, rows from the top (..., height, width).

    Attributes:
        depth: from the camera along the pixel's ray [m], at most the rig's reach.
        seen: uint8, `Seen`.
        shade: uint8 brightness in [0, `SHADES`], the same for all unless the rig is
            `shaded`.
    """

    depth: jax.Array
    seen: jax.Array
    shade: jax.Array


def see(
    rig: Rig,
    state: State,
    heights: Heights,
    faults: Faults | None = None,
    viewers: int | None = None,
) -> Pictures:
    """Pictures (viewers, cameras, height, width) of one lot.

    Dirt hides what is behind it as the own car does, at a depth of 0.

    Args:
        rig: the cameras, static.
        state: of the lot; cars are where they are, not where sensors measure them.
        heights: of its cars, static.
        faults: of the cameras; None = none.
        viewers: how many agents see, the first; None = all.
    """
    boxes, cylinders = lot_blocks(state, heights)
    rays = rig.directions.reshape(len(rig.cameras), -1, 3)
    motion = state.motion
    ratio = jnp.array(heights.agents, jnp.float32)
    ratio = ratio[0] if state.kind is None else ratio[state.kind[:viewers]]
    length, width = motion.size[:viewers, 0], motion.size[:viewers, 1]
    faults = jax.tree.map(lambda fault: fault[:viewers], faults)
    scale = jnp.stack([length / 2, width / 2, length * ratio], axis=-1)
    mounts = jnp.array([camera.position for camera in rig.cameras])
    eyes = mounts * scale[:, None]  # (agents, cameras, 3)

    def look(
        agent: jax.Array, goal: jax.Array, pose_w: jax.Array, eye: jax.Array, rays
    ):
        hit = _ground(state, goal, pose_w, eye, rays[above:])
        hit = jnp.concatenate([jnp.full(above, _SKY), hit])
        around = [seat(blocks, agent, pose_w, eye) for blocks in (boxes, cylinders)]
        return trace(hit, rays, around[0], around[1], rig.shaded)

    # No pixel before this one looks down.
    down = np.flatnonzero((rays[..., 2] < 0.0).any(axis=0))
    above = int(down[0]) if faults is None and down.size else 0
    aims, axis = jnp.asarray(rays), None
    if faults is not None:
        eyes = eyes + faults.shift
        aims, axis = jnp.einsum("acij,cpj->acpi", faults.turn, rays), 0
    of_camera = jax.vmap(look, in_axes=(None, None, None, 0, 0))
    of_car = jax.vmap(of_camera, in_axes=(0, 0, 0, 0, axis))
    agents = jnp.arange(eyes.shape[0])
    hit = of_car(agents, state.goal[:viewers], motion.pose_w[:viewers], eyes, aims)
    hit = hit.reshape(*hit.shape[:2], rig.height, rig.width)
    if faults is not None and faults.spots.shape[-2]:
        dirt = encode(jnp.float32(0.0), int(Seen.OWN_CAR), 0)
        hit = jnp.where(is_dirty(rig, faults.spots), dirt, hit)
    depth, seen, shade = decode(hit)
    return Pictures(
        depth=jnp.minimum(depth, rig.reach),
        seen=seen.astype(jnp.uint8),
        shade=shade.astype(jnp.uint8),
    )


def _ground(
    state: State, goal: jax.Array, pose_w: jax.Array, eye: jax.Array, rays: jax.Array
) -> jax.Array:
    """Hits of rays (..., 3) with the ground, or the sky."""
    x, y, drop = rays[..., 0], rays[..., 1], -rays[..., 2]
    slope = 1.0 / jnp.maximum(drop, _LEAST_DROP)
    place = Place(pose_w[:2] + rotate(eye[:2], pose_w[2]), pose_w[2])

    def down_to(height: jax.Array | float) -> jax.Array:
        return (eye[2] - height) * slope

    on = down_to(HEIGHTS[LINE])
    kind = cover(state.layout, goal, place, on * x, on * y)
    on = down_to(HEIGHTS[GRASS])
    kind = jnp.where(is_grass(state.layout, place, on * x, on * y), GRASS, kind)
    height = sum(
        jnp.where(kind == k, high, 0.0) for k, high in enumerate(HEIGHTS) if high
    )
    shows = sum(
        jnp.where(kind == k, int(show), 0) for k, show in enumerate(SHOWS) if show
    )
    ground = encode(down_to(height), shows, _BRIGHT)
    return jnp.where(drop > _LEAST_DROP, ground, _SKY)

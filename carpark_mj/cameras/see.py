"""What cars see: depth, kinds and colours of their cameras, or a view from above."""

import dataclasses
import math
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.cameras import ground
from carpark_mj.cameras.blocks import FLAT, Heights, lot_blocks, seat, stand, trace
from carpark_mj.cameras.ground import SHADES, SHOWS, Patches, Place, encode
from carpark_mj.cameras.rig import BODY, Faults, Rig, Seen, is_dirty
from carpark_mj.config.checks import CheckedConfig, Count, Positive
from carpark_mj.geometry.se2 import rotate
from carpark_mj.layouts.types import LINE_WIDTH
from carpark_mj.types import State

_LEAST_DROP = 1e-6  # of a ray that meets the ground


@struct.dataclass
class Pictures:
    """Pictures of the cameras of cars, rows from the top (..., height, width)."""

    depth: jax.Array  # along the pixel's ray [m], at most the rig's reach
    seen: jax.Array  # uint8, `Seen`
    shade: jax.Array  # uint8 brightness in [0, `SHADES`], equal for all if not `shaded`


def see(
    rig: Rig,
    state: State,
    heights: Heights,
    faults: Faults | None = None,
    viewers: int | None = None,
) -> Pictures:
    """Pictures (viewers, cameras, height, width) of one lot.

    Cars are where they are, not where sensors measure them. Rig and heights are static.
    Dirt hides what is behind it as the own car does, at a depth of 0. `viewers` is how
    many agents see, the first; None = all.
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

    def look(agent: Any, goal: Any, pose_w: Any, eye: Any, rays: Any) -> jax.Array:
        place = Place(pose_w[:2] + rotate(eye[:2], pose_w[2]), pose_w[2])
        hit = _ground_hits(state, goal, place, eye[2], rays[above:])
        hit = jnp.concatenate([jnp.full(above, ground.SKY), hit])
        around = [seat(each, agent, place, eye[2]) for each in (boxes, cylinders)]
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
    depth, seen, shade = ground.decode(hit)
    return Pictures(
        depth=jnp.minimum(depth, rig.reach),
        seen=seen.astype(jnp.uint8),
        shade=shade.astype(jnp.uint8),
    )


def _ground_hits(
    state: State, goal: jax.Array, place: Place, up: jax.Array, rays: jax.Array
) -> jax.Array:
    """Hits of rays (..., 3) with the ground, or the sky, from a height `up` () [m]."""
    x, y, drop = rays[..., 0], rays[..., 1], -rays[..., 2]
    slope = 1.0 / jnp.maximum(drop, _LEAST_DROP)

    def down_to(height: jax.Array | float) -> jax.Array:
        return (up - height) * slope

    on = down_to(ground.HEIGHTS[ground.LINE])
    kind = ground.cover(state.layout, goal, place, on * x, on * y)
    on = down_to(ground.HEIGHTS[ground.GRASS])
    grass = ground.is_grass(state.layout, place, on * x, on * y)
    kind = jnp.where(grass, ground.GRASS, kind)
    heights, kinds = enumerate(ground.HEIGHTS), enumerate(SHOWS)
    height = sum(jnp.where(kind == k, high, 0.0) for k, high in heights if high)
    shows = sum(jnp.where(kind == k, int(show), 0) for k, show in kinds if show)
    hit = encode(down_to(height), shows, FLAT)
    return jnp.where(drop > _LEAST_DROP, hit, ground.SKY)


# RGB in [0, 1] in full light.
COLOURS: dict[Seen, tuple[float, float, float]] = {
    Seen.FLOOR: (0.28, 0.29, 0.31),
    Seen.LINE: (0.95, 0.95, 0.92),
    Seen.OWN_BAY: (0.24, 0.62, 0.36),
    Seen.BAY: (0.36, 0.38, 0.44),
    Seen.WALL: (0.66, 0.65, 0.62),
    Seen.CAR: (0.84, 0.40, 0.22),
    Seen.PERSON: (0.97, 0.75, 0.12),
    Seen.KERB: (0.76, 0.76, 0.74),
    Seen.SKY: (0.72, 0.82, 0.92),
    Seen.OWN_CAR: (0.16, 0.17, 0.20),
}
Channel = Literal["colour", "depth", "seen"]
DARK = 20.0  # m, depth that is black


def colours(
    pictures: Pictures,
    faults: Faults | None = None,
    noise: float = 0.0,
    key: jax.Array | None = None,
) -> jax.Array:
    """RGB (..., height, width, 3) in [0, 1]; faces are as bright as in the sun.

    Faults give the exposure; noise of a standard deviation consumes the key.
    """
    palette = jnp.array([COLOURS[kind] for kind in Seen])
    rgb = palette[pictures.seen] * (pictures.shade[..., None] / SHADES)
    if faults is not None:
        rgb = rgb * faults.exposure[..., None, None, None]
    if noise:
        if key is None:
            raise ValueError(f"noise {noise} needs a key")
        rgb = rgb + noise * jax.random.normal(key, rgb.shape)
    return jnp.clip(rgb, 0.0, 1.0)


def paint(pictures: Pictures, channel: Channel) -> jax.Array:
    """Pictures to look at (..., height, width, 3) uint8.

    `colour` has the shades of the sun, `depth` is the brighter the nearer, `seen` has a
    colour for each kind.
    """
    if channel == "depth":
        near = 1.0 - jnp.minimum(pictures.depth / DARK, 1.0)
        rgb = jnp.repeat(near[..., None], 3, axis=-1)
    elif channel == "seen":
        rgb = jnp.array([COLOURS[kind] for kind in Seen])[pictures.seen]
    else:
        rgb = colours(pictures)
    return (255.0 * rgb).astype(jnp.uint8)


_ANY_HEIGHT = Heights((1.0,), (1.0,))


@dataclasses.dataclass(frozen=True)
class BirdsEye(CheckedConfig):
    """A square picture about the footprint's centre."""

    pixels: Count = 84  # of a side
    span: Positive = 21.0  # length of a side [m]


def see_from_above(config: BirdsEye, state: State) -> jax.Array:
    """Pictures (num_agents, pixels, pixels) uint8 `Seen`, rows from the front.

    Lines are at least as wide as a pixel.
    """
    boxes, cylinders = lot_blocks(state, _ANY_HEIGHT, of_cars=(BODY,))
    side = config.span * (0.5 - (np.arange(config.pixels) + 0.5) / config.pixels)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
    line_width = max(LINE_WIDTH, config.span / config.pixels)
    ahead, left = jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32)
    reach = config.span / math.sqrt(2) + line_width

    def look(agent: jax.Array, goal: jax.Array, pose_w: jax.Array) -> jax.Array:
        place = Place(pose_w[:2], pose_w[2])
        kind = ground.cover(state.layout, goal, place, ahead, left, line_width, reach)
        seen = jnp.array(SHOWS, jnp.int32)[kind]
        for blocks, inside in ((boxes, _in_box), (cylinders, _in_disc)):
            # `Seen` has the ground's kinds first.
            patches = stand(blocks, agent, place)
            seen = ground.lay(seen, patches, ahead, left, inside, reach)
        return seen

    agents = jnp.arange(state.goal.shape[0])
    seen = jax.vmap(look)(agents, state.goal, state.motion.pose_w)
    return seen.astype(jnp.uint8).reshape(-1, config.pixels, config.pixels)


def _in_box(box: Patches, x: jax.Array, y: jax.Array) -> jax.Array:
    inside = (jnp.abs(x) <= box.half[0]) & (jnp.abs(y) <= box.half[1])
    return jnp.where(inside, box.cover, 0)


def _in_disc(disc: Patches, x: jax.Array, y: jax.Array) -> jax.Array:
    return jnp.where(x * x + y * y <= disc.half[0] ** 2, disc.cover, 0)

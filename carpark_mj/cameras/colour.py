"""Colours of what cameras see, for policies and for people."""

from typing import Literal

import jax
import jax.numpy as jnp

from carpark_mj.cameras.faults import Faults
from carpark_mj.cameras.hits import SHADES
from carpark_mj.cameras.rig import Seen
from carpark_mj.cameras.see import Pictures

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
LUMA = (0.299, 0.587, 0.114)  # Rec. 601: what a camera's grey weighs


def colours(
    pictures: Pictures,
    faults: Faults | None = None,
    noise: float = 0.0,
    key: jax.Array | None = None,
) -> jax.Array:
    """RGB (..., height, width, 3) in [0, 1]; faces are as bright as in the sun.

    Args:
        pictures: what the cameras see.
        faults: of the cameras: their exposure.
        noise: standard deviation.
        key: consumed; needed for noise.
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

    Args:
        pictures: what the cameras see.
        channel: `colour`, with the shades of the sun; `depth`, the nearer the brighter;
            `seen`, a colour for each kind.
    """
    if channel == "depth":
        near = 1.0 - jnp.minimum(pictures.depth / DARK, 1.0)
        rgb = jnp.repeat(near[..., None], 3, axis=-1)
    elif channel == "seen":
        rgb = jnp.array([COLOURS[kind] for kind in Seen])[pictures.seen]
    else:
        rgb = colours(pictures)
    return (255.0 * rgb).astype(jnp.uint8)


def grey(rgb: jax.Array) -> jax.Array:
    """Brightness (...) in [0, 1] of colours (..., 3)."""
    return rgb @ jnp.array(LUMA)

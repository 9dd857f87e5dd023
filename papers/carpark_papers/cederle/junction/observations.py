"""Observations at the junction: the vector, un-normalised, and the image.

All objects are rectangles (the road's corners lack a disc). A pixel's grey is the mean
over the areas that objects cover in it: exact where an edge is parallel to the pixels,
within a few percent elsewhere. Objects are painted over each other: grass, asphalt,
paint, other cars, the own car. The study shows SMARTS's top-down camera, whose colours
are not recorded; here five levels are evenly spaced.

In this order, human-driven cars among the others: position less the goal's (2) [m],
distance to the goal (1) [m], position less that of every other car (2 each) [m],
distances to these (1 each) [m], speed (1) [m/s], steering angle (1) [rad], direction of
the heading (2), way driven (1) [m]: 11 numbers among 2 cars, 14 among 3, 17 among 4.
Axes are the world's. A car that has left is `FAR` away along both axes.
"""

import jax
import jax.numpy as jnp

from carpark_mj.geometry import norm, rotate
from carpark_papers.cederle.junction.config import RasterConfig
from carpark_papers.cederle.junction.roads import (
    CORNER,
    CORNER_CENTRES,
    MARKINGS,
    ROAD,
    Box,
)
from carpark_papers.cederle.junction.rules import State

OWN_CAR, GRASS, ASPHALT, PAINT, OTHER_CAR = 0, 64, 128, 191, 255
_STRIPS = len(ROAD) - len(CORNER_CENTRES)  # boxes of the road before the corners'


def draw(config: RasterConfig, state: State) -> jax.Array:
    """Images (num_agents, pixels, pixels) uint8, the first row farthest ahead."""
    n, pose, size = state.active.shape[0], state.motion.pose_w, state.motion.size
    xy = pixel_centres(config, pose[:n])
    pixel = config.extent / config.pixels
    covers = [_boxes(xy, box, pixel) for box in ROAD]
    for k, centre in enumerate(CORNER_CENTRES):
        outside = norm(xy - jnp.array(centre)) - CORNER
        covers[_STRIPS + k] *= jnp.clip(0.5 + outside / pixel, 0.0, 1.0)
    grey = jnp.full(xy.shape[:-1], float(GRASS))
    grey = _paint(grey, jnp.minimum(sum(covers, jnp.zeros_like(grey)), 1.0), ASPHALT)
    for line in MARKINGS:
        grey = _paint(grey, _boxes(xy, line, pixel), PAINT)
    for car in range(len(size)):
        local = rotate(xy - pose[car, :2], -pose[car, 2])
        cover = _cover(local, size[car], pixel) * state.present[car]
        own = jnp.arange(n)[:, None, None] == car
        grey = jnp.where(own, grey, _paint(grey, cover, OTHER_CAR))
    middle = rotate(xy - pose[:n, None, None, :2], -pose[:n, None, None, 2])
    grey = _paint(grey, _cover(middle, size[:n, None, None], pixel), OWN_CAR)
    return jnp.round(grey).astype(jnp.uint8)


def pixel_centres(config: RasterConfig, pose: jax.Array) -> jax.Array:
    """World points (n, pixels, pixels, 2) [m] of the images of cars at poses (n, 3)."""
    steps = config.extent * (0.5 - (jnp.arange(config.pixels) + 0.5) / config.pixels)
    ahead, left = jnp.meshgrid(steps, steps, indexing="ij")
    pose = pose[:, None, None]
    return pose[..., :2] + rotate(jnp.stack([ahead, left], axis=-1), pose[..., 2])


def _boxes(xy: jax.Array, box: Box, pixel: float) -> jax.Array:
    return _cover(xy - jnp.array(box.centre), jnp.array(box.size), pixel)


def _cover(local: jax.Array, size: jax.Array, pixel: float) -> jax.Array:
    """Share (...) of pixels that boxes cover; pixels taken as parallel to them.

    `local` (..., 2) are the pixels' middles in the boxes' frames, sizes (..., 2) [m].
    """
    half = 0.5 * size
    least = jnp.maximum(local - pixel / 2, -half)
    most = jnp.minimum(local + pixel / 2, half)
    share = jnp.maximum(most - least, 0.0) / pixel
    return share[..., 0] * share[..., 1]


def _paint(grey: jax.Array, cover: jax.Array, level: int) -> jax.Array:
    return grey + cover * (level - grey)


FAR = 100.0  # m


def vector_size(num_cars: int) -> int:
    """Numbers that an agent observes among `num_cars` cars."""
    return 5 + 3 * num_cars


def observe(state: State) -> jax.Array:
    """Vectors (num_agents, vector_size)."""
    motion, n = state.motion, state.active.shape[0]
    cars = motion.xy.shape[0]
    # Row k: the indices of all cars but k.
    others = jnp.arange(cars - 1) + (jnp.arange(cars - 1) >= jnp.arange(n)[:, None])
    xy: jax.Array = motion.xy[:n]
    apart = xy[:, None] - motion.xy[others]
    apart = jnp.where(state.present[others][..., None], apart, FAR)
    to_goal = xy - state.task.goal_xy
    yaw = motion.pose_w[:n, 2]
    parts = (
        to_goal,
        norm(to_goal)[:, None],
        apart.reshape(n, -1),
        norm(apart),
        motion.speed[:n, None],
        motion.steering[:n, None],
        jnp.cos(yaw)[:, None],
        jnp.sin(yaw)[:, None],
        (state.along - state.task.start)[:n, None],
    )
    return jnp.concatenate(parts, axis=-1)

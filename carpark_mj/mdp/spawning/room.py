"""Whether every agent finds a free start, wherever the others are."""

import math

import jax
import numpy as np

from carpark_mj.layouts.types import Layout

FREE = 0.25  # least share of a region's points that are free at any heading


def has_room(
    layout: Layout, size: tuple[float, float], num_agents: int, spacing: float
) -> bool:
    """Whether the last agent always finds a free start in the largest spawn region.

    Another car occupies the centres at which boxes would overlap it: their Minkowski
    sum. That of two l x w boxes turned by t against each other has the area
    2 l w + (l^2 + w^2) sin t + 2 l w cos t, and the perimeter 4 (l + w).

    Args:
        layout: the lot.
        size: length and width of the largest of the cars [m].
        num_agents: in the lot.
        spacing: of the grid of start positions [m], see `SpawnConfig`.
    """
    length, width = size
    both, squares = 2 * length * width, length**2 + width**2
    taken = both + math.hypot(squares, both)
    # A convex figure of area a and perimeter p holds at most a + p / 2 + 1 points of
    # the unit grid (Pick).
    taken += spacing * 2 * (length + width) + spacing**2
    sides = np.asarray(jax.device_get(layout.spawn_size), float)
    if spacing:
        sides = spacing * (2 * np.floor(0.5 * sides / spacing + 1e-4) + 1)
    area = np.where(layout.spawn_mask, sides[:, 0] * sides[:, 1], 0.0).max(initial=0.0)
    return bool((num_agents - 1) * taken <= (1 - FREE) * area)

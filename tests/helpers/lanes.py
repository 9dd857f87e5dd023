"""A lot with lanes of every kind."""

import math

import jax.numpy as jnp
from helpers.scenes import lot

from carpark_mj.layouts import build

EAST, NORTH, WEST, SOUTH = 0.0, math.pi / 2, math.pi, -math.pi / 2


def with_lanes(*groups, mask=None):
    """A lot of one bay with the lanes of some groups."""
    group = {
        name: jnp.concatenate([group[name] for group in groups]) for name in groups[0]
    }
    if mask is not None:
        group["lane_mask"] = jnp.array(mask)
    return lot([(100.0, 0.0, 0.0)]).replace(**group)


# An H of two aisles along x and a lane between their ends; the bay faces the far aisle.
BLOCK = build.assemble(
    (20.0, 30.0),
    build.lanes(
        [(0.0, 0.0, EAST), (0.0, 20.0, EAST), (12.0, 10.0, NORTH)],
        [(20.0, 4.0), (20.0, 4.0), (24.0, 4.0)],
    ),
    build.bays([(-5.0, 15.5, NORTH)], (5.0, 2.5)),
)
# A two-way street along x, 6 m wide; a one-way aisle crosses it northwards at x = 10,
# 4 m wide; and a garage's drive, where either way is right, leads south at x = -10.
PLAN = with_lanes(
    build.lanes(*build.two_lanes(jnp.zeros(3), jnp.array([40.0, 6.0]))),
    build.lanes([(10.0, 0.0, NORTH)], (20.0, 4.0)),
    build.lanes([(-10.0, -8.0, SOUTH)], (10.0, 4.0), one_way=False),
)

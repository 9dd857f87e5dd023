"""Misaligned starts: in the agent's goal bay, over its lines by centimetres or askew.

From there a car has to manoeuvre on the spot, which it otherwise rarely has to.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.geometry import box_inside, to_world
from carpark_mj.mdp.spawning.draws import pick
from carpark_mj.mdp.spawning.placing import Placing, SpawnInputs, Surroundings
from carpark_mj.mdp.spawning.reverse import parked_right

CANDIDATES = 16  # poses per start, of which one that is free is taken
FARTHEST = (0.5, 0.4, 0.15)  # along the bay and across [m], and askew [rad]
MARGIN = 0.05  # m kept to walls, discs and parked cars


class MisalignedDraws(NamedTuple):
    """Uniform numbers in [0, 1) for one start, with n poses.

    Attributes:
        off: (n, 3) offset from the middle, along the bay and across, and heading.
        nose_out: (n,) which way round the car stands.
        score: (n,) of the free poses the largest wins.
    """

    off: Any
    nose_out: Any
    score: Any


def misaligned_shapes(config: SpawnConfig) -> MisalignedDraws:
    """Shapes of the numbers of a start, for `draw_uniform`."""
    n = CANDIDATES if config.misaligned_ratio else 0
    return MisalignedDraws((n, 3), (n,), (n,))


def misaligned_pose(
    inputs: SpawnInputs,
    placing: Placing,
    around: Surroundings,
    agent: jax.Array,
    draws: MisalignedDraws,
) -> tuple[jax.Array, jax.Array]:
    """Draws a start in the goal bay of one agent, not within its lines.

    It overlaps no other agent, but may be right beside one.

    Args:
        inputs: the lot, and the parameters of the cars.
        placing: all agents; of this one the goal is drawn.
        around: obstacles to keep away from, parked cars as they will stand.
        agent: () int32 index.
        draws: random numbers.

    Returns:
        (3,) pose of the footprint's centre, and () bool whether there is one; otherwise
        the pose is invalid.
    """
    assert inputs.cars is not None
    layout, goal = inputs.layout, placing.goal[agent]
    bay_pose, bay_size = layout.bay_pose[goal], layout.bay_size[goal]
    size = inputs.cars.size[agent]
    off = (2.0 * draws.off - 1.0) * jnp.asarray(FARTHEST)
    nose_out = parked_right(layout, goal, draws.nose_out)
    turned = jnp.where(nose_out < 0.5, jnp.pi, 0.0)
    pose = to_world(bay_pose, off.at[:, 2].add(turned))
    good = ~around.blocks(pose, size + 2 * MARGIN) & around.free(pose)
    good = good & ~box_inside(pose, size, bay_pose, bay_size) & placing.found[agent]
    return pose[pick(good, draws.score)], good.any()

"""Reverse starts: on a path that leads out of the agent's goal bay.

The path is a few arcs of a kinematic bicycle that touch nothing that stands still.
Driven back it ends in the bay, so every such episode can be solved.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import SpawnConfig
from carpark_mj.geometry import box_inside, norm, wrap_angle
from carpark_mj.layouts.types import BayEnd, Layout
from carpark_mj.mdp.spawning.draws import pick
from carpark_mj.mdp.spawning.placing import Placing, SpawnInputs, Surroundings
from carpark_mj.types import Vehicle

CANDIDATES = 8  # paths per start, of which the longest counts
ARCS = 3
LONGEST = 10.0  # m of path
SPACING = 0.25  # m between the points of a path, each tested
POINTS = round(LONGEST / SPACING) + 1
MARGIN = 0.05  # m kept to walls, discs and parked cars along the path
# From the middle of the bay to the start [m]: farther than the rules `tanner` (0.8 m)
# and `precise` (0.2 m) allow; what `strict` allows, a box within the lines, is tested.
NEAREST = 1.0
# Room to other agents' footprints [m]: from 3 m/s, the highest speed of the presets,
# they brake to a stop within 1.7 m, a control step of reaction included.
ROOM = 2.0


class ReverseDraws(NamedTuple):
    """Uniform numbers in [0, 1) for one start, with n paths.

    Attributes:
        nose_out: (n,) which way round the car stands in the bay.
        share: (n, ARCS) shares of the arcs in a path.
        curvature: (n, ARCS) of the arcs, up to the car's sharpest to either side.
        direction: (n, ARCS) whether it is driven forwards.
        point: (POINTS,) which point of the path.
    """

    nose_out: Any
    share: Any
    curvature: Any
    direction: Any
    point: Any


def reverse_shapes(config: SpawnConfig) -> ReverseDraws:
    """Shapes of the numbers of a start, for `draw_uniform`."""
    n, points = (CANDIDATES, POINTS) if config.reverse_ratio else (0, 0)
    return ReverseDraws((n,), (n, ARCS), (n, ARCS), (n, ARCS), (points,))


def reverse_pose(
    inputs: SpawnInputs,
    placing: Placing,
    around: Surroundings,
    agent: jax.Array,
    draws: ReverseDraws,
) -> tuple[jax.Array, jax.Array]:
    """Draws a start on a path out of the goal's bay for one agent.

    Every path ends before it touches anything, and the longest is taken. The start is
    uniform among those of its points that no rule calls parked and that leave `ROOM` to
    the other agents.

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
    nose_out = parked_right(layout, goal, draws.nose_out)
    draws = draws._replace(nose_out=nose_out)
    paths = paths_out(inputs.cars, agent, bay_pose, draws)

    blocked = around.blocks(paths.reshape(-1, 3), size + 2 * MARGIN)
    outside = jnp.abs(paths[..., :2]) > layout.extent  # not every lot has walls around
    stop = blocked.reshape(paths.shape[:2]) | outside[..., 0] | outside[..., 1]
    count = jnp.where(stop.any(axis=1), jnp.argmax(stop, axis=1), POINTS)
    longest = jnp.argmax(count)
    path = paths[longest]

    clear = jnp.arange(POINTS) < count[longest]
    out = norm(path[:, :2] - bay_pose[:2]) >= NEAREST
    out = out & ~box_inside(path, size, bay_pose, bay_size)
    alone = around.room(path) > ROOM
    # Without a bay for the new car the old one is kept, whose size may be another.
    good = clear & out & alone & placing.found[agent]
    return path[pick(good, draws.point)], good.any()


def parked_right(layout: Layout, bay: jax.Array, nose_out: jax.Array) -> jax.Array:
    """Which way round cars stand (n,) in a bay () of those drawn, by its `BayEnd`.

    Numbers below 0.5 are cars with their nose in.
    """
    if layout.bay_end is None:
        return nose_out
    end = layout.bay_end[bay]
    nose_out = jnp.where(end == BayEnd.NOSE_FIRST, 0.0, nose_out)
    return jnp.where(end == BayEnd.TAIL_FIRST, 1.0, nose_out)


def paths_out(
    cars: Vehicle, agent: jax.Array, bay_pose: jax.Array, draws: ReverseDraws
) -> jax.Array:
    """Ways out of a bay, as points `SPACING` apart.

    The rear axle of a kinematic bicycle moves on arcs whose chords are known, so all
    points are computed at once.

    Args:
        cars: parameters (num_agents,).
        agent: () int32 index of the car that drives.
        bay_pose: (3,) where it stands at first, one way round or the other.
        draws: random numbers of n paths.

    Returns:
        (n, POINTS, 3) poses of the footprint's centre.
    """
    ahead = cars.centre_offset[agent]  # of the rear axle
    sharpest = jnp.tan(cars.max_steering[agent]) / cars.wheelbase[agent]
    curvature = (2.0 * draws.curvature - 1.0) * sharpest
    direction = jnp.where(draws.direction < 0.5, -1.0, 1.0)
    share = 1.0 - draws.share  # in (0, 1]
    arcs = LONGEST * share / sum(share[:, k : k + 1] for k in range(ARCS))

    turned = jnp.where(draws.nose_out < 0.5, jnp.pi, 0.0)
    yaw = (bay_pose[2] + turned)[:, None]
    x = bay_pose[0] - ahead * jnp.cos(yaw)
    y = bay_pose[1] - ahead * jnp.sin(yaw)
    rest = SPACING * jnp.arange(POINTS)
    for k in range(ARCS):
        arc = arcs[:, k, None]
        driven = direction[:, k, None] * jnp.clip(rest, 0.0, arc)
        turn = curvature[:, k, None] * driven
        chord = driven * jnp.sinc(turn / (2.0 * jnp.pi))
        x = x + chord * jnp.cos(yaw + turn / 2.0)
        y = y + chord * jnp.sin(yaw + turn / 2.0)
        yaw, rest = yaw + turn, rest - arc
    x, y = x + ahead * jnp.cos(yaw), y + ahead * jnp.sin(yaw)
    return jnp.stack([x, y, wrap_angle(yaw)], axis=-1)

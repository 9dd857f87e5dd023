"""How an agent's episode ends: parked, crashed, timed out or diverged."""

import dataclasses
import math

import jax
import jax.numpy as jnp

from carpark_mj.config import EpisodeConfig
from carpark_mj.config.grid import WORLD_UNIT
from carpark_mj.geometry import (
    axis_angle_error,
    box_disc_overlap,
    box_inside,
    boxes_overlap,
    rotate,
)
from carpark_mj.geometry.broad_phase import is_crowded, near_box_hits, near_disc_hits
from carpark_mj.layouts.types import Layout
from carpark_mj.types import Events, Motion

TANNER_TOLERANCE = 1.001 * WORLD_UNIT  # m, in x and in y (Tanner's code)
STRICT_HEADING = math.radians(5.0)
STRICT_SPEED = 0.2  # m/s
PRECISE_DISTANCE = 0.2  # m
PRECISE_HEADING = math.radians(3.0)
PRECISE_SPEED = 0.05  # m/s


def is_parked(
    rule: str, vehicle: Motion, bay_pose: jax.Array, bay_size: jax.Array
) -> jax.Array:
    """Whether cars (...) stand parked in bays under a named rule.

    Args:
        rule: `tanner`, `strict` or `precise`; see `EpisodeConfig`.
        vehicle: states of the cars (...).
        bay_pose: (..., 3) each car's goal.
        bay_size: (..., 2).
    """
    offset = jnp.abs(vehicle.pose_w[..., :2] - bay_pose[..., :2])
    if rule == "tanner":
        # Tanner compares along his lot's axes. All rows are axis-parallel there, so
        # the bay's own axes give the same, and make the rule independent of the frame.
        offset = jnp.abs(
            rotate(vehicle.pose_w[..., :2] - bay_pose[..., :2], -bay_pose[..., 2])
        )
        return jnp.all(offset < TANNER_TOLERANCE, axis=-1)
    heading = axis_angle_error(vehicle.pose_w[..., 2] - bay_pose[..., 2])
    speed = jnp.linalg.norm(vehicle.velocity_b, axis=-1)
    if rule == "strict":
        inside = box_inside(vehicle.pose_w, vehicle.size, bay_pose, bay_size)
        return inside & (heading < STRICT_HEADING) & (speed < STRICT_SPEED)
    distance = jnp.linalg.norm(offset, axis=-1)
    return (
        (distance < PRECISE_DISTANCE)
        & (heading < PRECISE_HEADING)
        & (speed < PRECISE_SPEED)
    )


def find_hits(
    layout: Layout,
    vehicle: Motion,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    hitbox_scale: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """What each agent touched during the step.

    Physics with contacts says so itself; otherwise its footprint overlapped the
    other's at a traced instant.

    Args:
        layout: the lot.
        vehicle: the agents (num_agents,).
        parked_pose: (num_parked_cars, 3) poses of the parked cars.
        parked_size: (num_parked_cars, 2) footprints of the parked cars [m].
        hitbox_scale: () what all cars' lengths and widths count times, a training aid;
            None = 1. Physics with contacts knows nothing of it.

    Returns:
        (num_agents,) bool each: another agent, a parked car, a wall or disc (pillar,
        bollard). In a collision of two agents both are hit.
    """
    if vehicle.touched is not None:
        agent, parked_car, wall = jnp.moveaxis(vehicle.touched, -1, 0)
        return agent, parked_car, wall
    if hitbox_scale is not None:
        vehicle = dataclasses.replace(vehicle, size=vehicle.size * hitbox_scale)
        parked_size = parked_size * hitbox_scale
    agents, parked, walls = _box_hits(layout, vehicle, parked_pose, parked_size)
    return agents, parked, walls | _disc_hits(layout, vehicle)


def _box_hits(
    layout: Layout,
    vehicle: Motion,
    parked_pose: jax.Array,
    parked_size: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Who overlapped another agent, a parked car, a wall; (num_agents,) bool each."""
    num_agents, num_parked = vehicle.size.shape[0], parked_size.shape[0]
    num_walls = layout.wall_mask.shape[0]
    if is_crowded(num_agents, num_agents + num_parked + num_walls):
        hits = near_box_hits(
            vehicle,
            jnp.concatenate([parked_pose, layout.wall_pose]),
            jnp.concatenate([parked_size, layout.wall_size]),
            jnp.concatenate([jnp.ones(num_parked, bool), layout.wall_mask]),
            1 + (jnp.arange(num_parked + num_walls) >= num_parked),
        )
        return hits[:, 0], hits[:, 1], hits[:, 2]
    own = vehicle.trace_w[:, None]  # (agents, 1, traces, 3)
    own_size = vehicle.size[:, None, None]
    agents = boxes_overlap(
        own, own_size, vehicle.trace_w[None], vehicle.size[None, :, None]
    )
    agents = agents & ~jnp.eye(num_agents, dtype=bool)[..., None]
    parked = boxes_overlap(
        own, own_size, parked_pose[None, :, None], parked_size[None, :, None]
    )
    walls = boxes_overlap(
        own, own_size, layout.wall_pose[None, :, None], layout.wall_size[None, :, None]
    )
    walls = walls & layout.wall_mask[None, :, None]
    return agents.any((1, 2)), parked.any((1, 2)), walls.any((1, 2))


def _disc_hits(layout: Layout, vehicle: Motion) -> jax.Array:
    """Who overlapped a disc; (num_agents,) bool."""
    centre, radius, mask = layout.disc_centre, layout.disc_radius, layout.disc_mask
    if is_crowded(vehicle.size.shape[0], mask.shape[0]):
        return near_disc_hits(vehicle, centre, radius, mask)
    discs = box_disc_overlap(
        vehicle.trace_w[:, None],
        vehicle.size[:, None, None],
        centre[None, :, None],
        radius[None, :, None],
    )
    return (discs & mask[None, :, None]).any((1, 2))


def judge(
    config: EpisodeConfig,
    layout: Layout,
    vehicle: Motion,
    goal: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    step: jax.Array,
    active: jax.Array,
    dynamic_goals: bool = False,
    hitbox_scale: jax.Array | None = None,
) -> Events:
    """Decides how each agent's episode stands after a step.

    A diverged car is out before anything else is asked. Under `tanner` an agent that
    parks cannot crash in the same step (his order of checks); under the other rules a
    touch anywhere in the step is a crash.

    Args:
        config: rules.
        layout: the lot.
        vehicle: the agents (num_agents,).
        goal: (num_agents,) bay indices.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        step: (num_agents,) int, control steps made in the episode, this one included.
        active: (num_agents,) bool; finished agents have no events.
        dynamic_goals: goals may be shared, or none, which is the number of bays: then
            nobody parks, and of two agents in one bay only the first does.
        hitbox_scale: of crashes only, see `find_hits`.
    """
    hit_agent, hit_parked_car, hit_wall = find_hits(
        layout, vehicle, parked_pose, parked_size, hitbox_scale
    )
    hit = hit_agent | hit_parked_car | hit_wall
    in_bay = is_parked(
        config.parked_rule, vehicle, layout.bay_pose[goal], layout.bay_size[goal]
    )
    if dynamic_goals:
        in_bay = in_bay & active & vehicle.finite & (goal < layout.num_bays)
        shared = jnp.tril(goal[:, None] == goal, k=-1)
        in_bay = in_bay & ~(shared & in_bay).any(axis=1)
    diverged = active & ~vehicle.finite
    alive = active & vehicle.finite
    if config.parked_rule == "tanner":
        parked = alive & in_bay
        crashed = alive & hit & ~parked
    else:
        crashed = alive & hit
        parked = alive & in_bay & ~crashed
    timed_out = alive & ~parked & ~crashed & (step >= config.max_steps)
    return Events(
        parked=parked,
        crashed=crashed,
        timed_out=timed_out,
        diverged=diverged,
        hit_agent=crashed & hit_agent,
        hit_parked_car=crashed & hit_parked_car,
        hit_wall=crashed & hit_wall,
    )

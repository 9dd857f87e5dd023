"""Puts the observation vector together in the order of `fields.make_fields`."""

import jax
import jax.numpy as jnp

from carpark_mj.config import ObservationConfig
from carpark_mj.geometry import to_local
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.ego import own_car, own_goal, own_motion
from carpark_mj.observations.fields import FAR, make_fields
from carpark_mj.observations.lane import own_lane
from carpark_mj.observations.localised import localise, nearest
from carpark_mj.observations.rays import cast_rays
from carpark_mj.observations.rings import count_rings, ring_counts
from carpark_mj.observations.spaces import goal_code, rival_fields, tracked_bays
from carpark_mj.observations.tracking import in_view, track_agents
from carpark_mj.types import Motion


def observe(
    config: ObservationConfig,
    layout: Layout,
    vehicle: Motion,
    goal: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    max_speed: jax.Array,
    max_steering: jax.Array,
    parked_present: jax.Array | None = None,
    axles: tuple[jax.Array, jax.Array] | None = None,
    spaces: jax.Array | None = None,
    ring_history: jax.Array | None = None,
) -> jax.Array:
    """Observations of all agents of a lot.

    Args:
        config: what is observed.
        layout: the lot.
        vehicle: the agents (num_agents,).
        goal: (num_agents,) bay indices; `layout.num_bays` = exploring.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        max_speed: (num_agents,) forward limits [m/s].
        max_steering: (num_agents,) [rad].
        parked_present: (num_parked_cars,) bool; None = all.
        axles: (num_agents,) wheelbases, and rear axles to footprints' centres [m];
            needed for `own_car`.
        spaces: (num_agents, num_spaces) bays tracked, `layout.num_bays` = none; None
            while goals are fixed.
        ring_history: see `rings.init_history`.

    Returns:
        (num_agents, observation_size) float32.
    """
    num_bays, num_spaces = layout.num_bays, 0
    goal_pose = layout.bay_pose[goal]
    values = own_motion(vehicle, max_speed, max_steering)
    own = own_goal(vehicle, goal_pose, layout.bay_size[goal])
    if spaces is not None:
        heading_somewhere = (goal < num_bays)[:, None]
        own = {k: jnp.where(heading_somewhere, v, 0.0) for k, v in own.items()}
    values |= own
    if config.own_car and axles is not None:
        values |= own_car(vehicle, *axles, max_steering)
    own_xy = vehicle.pose_w[:, :2]
    if spaces is not None:
        num_spaces = spaces.shape[1]
        choice = goal_code(goal[:, None], spaces, num_bays)[:, 0]
        values["goal_choice"] = jax.nn.one_hot(choice, num_spaces + 1)
        seen = in_view(config, vehicle.pose_w, layout.bay_pose[spaces, :2])
        spaces = jnp.where(seen, spaces, num_bays)
        bays = tracked_bays(layout, vehicle, spaces)
        if config.global_information:
            bays |= rival_fields(layout, own_xy, goal, spaces)
        values |= _numbered("space", bays, num_spaces)
    elif config.global_information:
        rivals = rival_fields(layout, own_xy, goal, goal[:, None])
        values |= {f"goal_{name}": value[:, 0] for name, value in rivals.items()}

    if config.tracked_agents:
        index, present = track_agents(config, vehicle.pose_w)
        agents = localise(
            vehicle.pose_w, vehicle.pose_w[index], vehicle.size[index], present
        )
        shared = {}
        if config.share_speeds:
            speed = vehicle.speed[index] / max_speed[:, None]
            shared["speed"] = speed[..., None]
        if config.share_goals and spaces is not None:
            code = goal_code(goal[index], spaces, num_bays)
            shared["goal"] = jax.nn.one_hot(code, num_spaces + 2)
        elif config.share_goals:
            local = to_local(vehicle.pose_w[:, None], goal_pose[index])
            shared["goal"] = local[..., :2] / FAR
            if config.share_goal_heading:
                yaw = local[..., 2]
                shared["goal_heading"] = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], -1)
        agents |= {
            name: jnp.where(present[..., None], value, 0.0)
            for name, value in shared.items()
        }
        values |= _numbered("agent", agents, config.tracked_agents)
    if config.tracked_parked_cars:
        pose, size = parked_pose, parked_size
        if pose.shape[0] == 0:  # nobody to track: a masked stand-in keeps the shapes
            pose, size = jnp.zeros((1, 3)), jnp.zeros((1, 2))
        mask = jnp.full((own_xy.shape[0], pose.shape[0]), parked_pose.shape[0] > 0)
        if parked_present is not None and parked_pose.shape[0]:
            mask = mask & parked_present
        mask = mask & in_view(config, vehicle.pose_w, pose[:, :2])
        index, present = nearest(own_xy, pose[:, :2], mask, config.tracked_parked_cars)
        cars = localise(vehicle.pose_w, pose[index], size[index], present)
        values |= _numbered("parked", cars, config.tracked_parked_cars)
    if config.rings:
        now = count_rings(config, layout, vehicle, parked_pose, parked_size)
        counts = ring_counts(config, now, ring_history)
        values |= {name: count / config.ring_cap for name, count in counts.items()}
    if config.rays:
        values["rays"] = cast_rays(
            vehicle.pose_w,
            vehicle.size,
            parked_pose,
            parked_size,
            jnp.ones(parked_pose.shape[0], bool)
            if parked_present is None
            else parked_present,
            layout,
            config.rays,
            config.ray_range,
        )
    if config.lane:
        values |= own_lane(layout, vehicle.pose_w)

    fields = make_fields(config, None, num_spaces)
    ordered = [values.pop(field.name) for field in fields]
    if values:
        raise AssertionError(f"undeclared observation fields: {sorted(values)}")
    return jnp.concatenate(ordered, axis=-1).astype(jnp.float32)


def _numbered(
    kind: str, fields: dict[str, jax.Array], count: int
) -> dict[str, jax.Array]:
    return {
        f"{kind}_{k}_{name}": value[:, k]
        for k in range(count)
        for name, value in fields.items()
    }

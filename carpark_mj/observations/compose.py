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
from carpark_mj.observations.rings import count_rings
from carpark_mj.types import VehicleState


def observe(
    config: ObservationConfig,
    layout: Layout,
    vehicle: VehicleState,
    goal: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    max_speed: jax.Array,
    max_steering: jax.Array,
    parked_present: jax.Array | None = None,
    axles: tuple[jax.Array, jax.Array] | None = None,
    spaces: jax.Array | None = None,
) -> jax.Array:
    """Observations of all agents of a lot.

    Args:
        config: what is observed.
        layout: the lot.
        vehicle: the agents (num_agents,).
        goal: (num_agents,) bay indices.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        max_speed: (num_agents,) forward limits [m/s].
        max_steering: (num_agents,) [rad].
        parked_present: (num_parked_cars,) bool; None = all.
        axles: (num_agents,) wheelbases, and rear axles to footprints' centres [m];
            needed for `own_car`.
        spaces: (num_agents, num_spaces) bays tracked by each agent, whose own goal and
            goals seen of others are 0 while these explore; None while goals are fixed.

    Returns:
        (num_agents, observation_size) float32.
    """
    goal_pose = layout.bay_pose[goal]
    values = own_motion(vehicle, max_speed, max_steering)
    goal_values = own_goal(vehicle, goal_pose, layout.bay_size[goal])
    exploring = None if spaces is None else goal == layout.num_bays
    if exploring is not None:
        goal_values = {
            name: jnp.where(exploring[:, None], 0.0, value)
            for name, value in goal_values.items()
        }
    values |= goal_values
    if config.own_car and axles is not None:
        values |= own_car(vehicle, *axles, max_steering)
    own_xy = vehicle.pose_w[:, :2]

    if config.tracked_agents:
        other = ~jnp.eye(own_xy.shape[0], dtype=bool)
        index, present = nearest(own_xy, own_xy, other, config.tracked_agents)
        agents = localise(
            vehicle.pose_w, vehicle.pose_w[index], vehicle.size[index], present
        )
        their_goal = to_local(vehicle.pose_w[:, None], goal_pose[index])[..., :2] / FAR
        if exploring is not None:
            their_goal = jnp.where(exploring[index][..., None], 0.0, their_goal)
        motion = {
            "speed": (vehicle.speed[index] / max_speed[:, None])[..., None],
            "goal": their_goal,
        }
        agents |= {
            name: jnp.where(present[..., None], value, 0.0)
            for name, value in motion.items()
        }
        values |= _numbered("agent", agents, config.tracked_agents)
    if config.tracked_parked_cars:
        pose, size = parked_pose, parked_size
        if pose.shape[0] == 0:  # nobody to track: a masked stand-in keeps the shapes
            pose, size = jnp.zeros((1, 3)), jnp.zeros((1, 2))
        mask = jnp.full((own_xy.shape[0], pose.shape[0]), parked_pose.shape[0] > 0)
        if parked_present is not None and parked_pose.shape[0]:
            mask = mask & parked_present
        index, present = nearest(own_xy, pose[:, :2], mask, config.tracked_parked_cars)
        cars = localise(vehicle.pose_w, pose[index], size[index], present)
        values |= _numbered("parked", cars, config.tracked_parked_cars)
    if config.rings:
        count = count_rings(own_xy, layout, config.rings, config.ring_cap)
        for k, diameter in enumerate(config.rings):
            values[f"ring_{diameter:g}m"] = count[:, k : k + 1]
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

    ordered = [values.pop(field.name) for field in make_fields(config)]
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

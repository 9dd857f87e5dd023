"""The continuous encoding: real numbers of order 1 in the observer's body frame."""

import dataclasses
import math

import jax
import jax.numpy as jnp

from carpark_mj.config import ContinuousObservation
from carpark_mj.geometry import to_local
from carpark_mj.layouts.routes import way_to
from carpark_mj.observations import bay_fields, ego, lane, localised
from carpark_mj.observations.fields import (
    FAR,
    FARTHEST,
    Field,
    far,
    repeated,
    repeated_values,
)
from carpark_mj.observations.rays import cast_rays, ray_fields
from carpark_mj.observations.rings import ring_counts, ring_fields
from carpark_mj.observations.sensors import observed
from carpark_mj.observations.tracking import in_view, track_agents, track_parked_cars
from carpark_mj.obstacles.lot import lot_obstacles
from carpark_mj.types import NO_BAY, Motion, ParkedCars, State


def continuous_fields(
    config: ContinuousObservation, num_tracked_bays: int
) -> list[Field]:
    """Lists the fields in order; `num_tracked_bays` is 0 while goals are fixed."""
    fields = [*ego.MOTION_FIELDS, *ego.GOAL_FIELDS]
    rivals = bay_fields.RIVAL_FIELDS if config.global_information else ()
    if num_tracked_bays:
        meaning = "one-hot: exploring, or which tracked bay is the goal"
        fields.append(Field("goal_choice", num_tracked_bays + 1, 0.0, 1.0, meaning))
        bay = (*bay_fields.BAY_FIELDS, *rivals)
        fields += repeated("bay", num_tracked_bays, bay)
    else:
        fields += [dataclasses.replace(f, name=f"goal_{f.name}") for f in rivals]
    if config.lines:
        fields += ego.LINE_FIELDS
    if config.route:
        fields += ego.ROUTE_FIELDS
    if config.own_car:
        fields += ego.CAR_FIELDS
    agent = [*localised.CAR_FIELDS, *_shared_fields(config, num_tracked_bays)]
    fields += repeated("agent", config.tracked_agents, agent)
    fields += repeated("parked_car", config.tracked_parked_cars, localised.CAR_FIELDS)
    circle = f"the circle about the car [{config.rings.cap}]"
    fields += ring_fields(config.rings, 1.0, circle)
    fields += ray_fields(config.rays)
    if config.lane:
        fields += lane.LANE_FIELDS
    return fields


def continuous_values(
    config: ContinuousObservation, state: State
) -> dict[str, jax.Array]:
    """Values (num_agents, k) of the fields by name."""
    layout, goal, motion = state.layout, state.goal, observed(state)
    own_xy, vehicle, bays = motion.xy, state.physics.vehicle, state.tracked_bays
    values = ego.own_motion(motion, vehicle)
    own_goal = ego.own_goal(motion, layout, goal)
    if config.lines:
        own_goal |= ego.own_lines(motion, layout, goal)
    if bays is not None:
        has_goal = ~state.exploring[:, None]
        own_goal = {k: jnp.where(has_goal, v, 0.0) for k, v in own_goal.items()}
        choice = bay_fields.goal_code(goal[:, None], bays)[:, 0]
        values["goal_choice"] = jax.nn.one_hot(choice, bays.shape[1] + 1)
        seen = in_view(config.view, motion.pose_w, layout.bay_pose[bays, :2])
        bays = jnp.where(seen, bays, NO_BAY)
        described = bay_fields.localise_bays(layout, motion, bays)
        if config.global_information:
            described |= bay_fields.rival_values(layout, own_xy, goal, bays)
        values |= repeated_values("bay", described)
    elif config.global_information:
        rivals = bay_fields.rival_values(layout, own_xy, goal, goal[:, None])
        values |= {f"goal_{name}": value[:, 0] for name, value in rivals.items()}
    values |= own_goal
    if config.route:
        values |= ego.own_route(motion, way_to(state.routes, layout, own_xy, goal))
    if config.own_car:
        values |= ego.own_car(motion, vehicle)
    if config.tracked_agents:
        index, present = track_agents(config, motion.pose_w, state.present)
        pose, size = motion.pose_w[index], motion.size[index]
        agents = localised.localise(motion.pose_w, pose, size, present)
        shared = _shared_values(config, state, motion, bays, index)
        agents |= {k: jnp.where(present[..., None], v, 0.0) for k, v in shared.items()}
        values |= repeated_values("agent", agents)
    if config.tracked_parked_cars:
        parked = _at_least_one(state.parked_cars)
        index, present = track_parked_cars(config, motion.pose_w, parked)
        pose, size = parked.pose_w[index], parked.size[index]
        cars = localised.localise(motion.pose_w, pose, size, present)
        values |= repeated_values("parked_car", cars)
    counts = ring_counts(config.rings, state)
    values |= {name: count / config.rings.cap for name, count in counts.items()}
    if config.rays.count:
        there = lot_obstacles(layout, motion, state.parked_cars, state.movers)
        values["rays"] = cast_rays(config.rays, motion, there)
    if config.lane:
        values |= lane.own_lane(layout, motion.pose_w)
    return values


def _shared_fields(config: ContinuousObservation, num_tracked_bays: int) -> list[Field]:
    """What tracked agents share, by `ShareConfig`."""
    fields = []
    if config.share.speeds:
        meaning = "its signed speed [own forward limit]"
        fields.append(Field("speed", 1, -1.5, 1.5, meaning, speed=math.inf))
    if config.share.goals and num_tracked_bays:
        meaning = "one-hot: it explores, its goal's place among the own bays, none"
        fields.append(Field("goal", num_tracked_bays + 2, 0.0, 1.0, meaning))
    elif config.share.goals:
        meaning = f"centre of its goal, body frame [{FAR:g} m]"
        fields.append(Field("goal", 2, -FARTHEST, FARTHEST, meaning, metres=FAR))
    if config.share.goal_headings:
        meaning = "cos and sin of its goal's minus own"
        fields.append(Field("goal_heading", 2, -1.0, 1.0, meaning))
    if config.share.steering:
        meaning = "its road-wheel angle [its limit], left > 0"
        fields.append(Field("steering", 1, -1.0, 1.0, meaning))
    if config.share.order:
        meaning = "1 if its number in the lot is lower than the own, else 0"
        fields.append(Field("order", 1, 0.0, 1.0, meaning))
    return fields


def _shared_values(
    config: ContinuousObservation,
    state: State,
    motion: Motion,
    bays: jax.Array | None,
    index: jax.Array,
) -> dict[str, jax.Array]:
    """What the agents `index` (num_agents, count) share, (num_agents, count, k).

    Args:
        config: what is shared.
        state: of the lot.
        motion: the agents (num_agents,), as observed.
        bays: (num_agents, num_tracked_bays) tracked and in view; None = fixed goals.
        index: of the agents that each tracks.
    """
    shared = {}
    if config.share.speeds:
        max_speed = state.physics.vehicle.max_speed
        shared["speed"] = (motion.speed[index] / max_speed[:, None])[..., None]
    if config.share.goals and bays is not None:
        code = bay_fields.goal_code(state.goal[index], bays)
        shared["goal"] = jax.nn.one_hot(code, bays.shape[1] + 2)
    elif config.share.goals:
        goal_pose = state.layout.parked_pose[state.goal]
        local = to_local(motion.pose_w[:, None], goal_pose[index])
        shared["goal"] = far(local[..., :2])
        if config.share.goal_headings:
            yaw = local[..., 2]
            shared["goal_heading"] = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
    if config.share.steering:
        steering = motion.steering / state.physics.vehicle.max_steering
        shared["steering"] = steering[index][..., None]
    if config.share.order:
        before = index < jnp.arange(index.shape[0])[:, None]
        shared["order"] = before[..., None].astype(jnp.float32)
    return shared


def _at_least_one(parked_cars: ParkedCars) -> ParkedCars:
    """The parked cars; one that is absent keeps the shapes where there are none."""
    if parked_cars.bay.shape[0]:
        return parked_cars
    return ParkedCars(
        bay=jnp.full(1, NO_BAY), pose_w=jnp.zeros((1, 3)), size=jnp.zeros((1, 2))
    )

"""What an agent observes of itself, its goal and its lane."""

import functools
import math

import jax
import jax.numpy as jnp

from carpark_mj.geometry import box_room, norm, rotate, to_local
from carpark_mj.layouts.routes import RouteLeft, has_lanes, nearest_lane, route_to
from carpark_mj.observations.fields import (
    CLOSE,
    FAR,
    FARTHEST,
    LENGTH,
    NEAR,
    Field,
    far,
)
from carpark_mj.observations.parts import Part, Sight

_GoalField = functools.partial(Field, reveals_goal=True)


def _motion(sight: Sight) -> dict[str, jax.Array]:
    motion, vehicle = sight.motion, sight.vehicle
    return {
        "speed": (motion.speed / vehicle.max_speed)[..., None],
        "steering": (motion.steering / vehicle.max_steering)[..., None],
        "yaw_rate": motion.yaw_rate[..., None],
    }


MOTION = Part(
    (
        Field(
            "speed", 1, -1.5, 1.5, "own signed speed [forward limit]", speed=math.inf
        ),
        Field("steering", 1, -1.0, 1.0, "own road-wheel angle [its limit], left > 0"),
        Field(
            "yaw_rate",
            1,
            -2.0,
            2.0,
            "own yaw rate [rad/s], left > 0",
            speed=1.0,
            is_yaw_rate=True,
        ),
    ),
    _motion,
)


def _goal(sight: Sight) -> dict[str, jax.Array]:
    layout, motion, goal = sight.layout, sight.motion, sight.goal
    goal_pose, goal_size = layout.bay_pose[goal], layout.bay_size[goal]
    local = to_local(motion.pose_w, layout.parked_pose[goal])
    inverse = to_local(goal_pose, motion.pose_w)
    xy = local[..., :2]
    values = {
        "goal_position": far(xy),
        "goal_near": jnp.clip(xy / NEAR, -1.0, 1.0),
        "goal_heading": jnp.stack(
            [jnp.cos(local[..., 2]), jnp.sin(local[..., 2])], axis=-1
        ),
        "goal_distance": far(norm(xy)[..., None]),
        "in_bay": jnp.clip(inverse[..., :2] / NEAR, -1.0, 1.0),
        "goal_size": (goal_size - motion.size) / LENGTH,
    }
    return sight.with_goal(values)


GOAL = Part(
    (
        _GoalField(
            "goal_position",
            2,
            -FARTHEST,
            FARTHEST,
            f"goal centre, body frame [{FAR:g} m]",
            metres=FAR,
        ),
        _GoalField(
            "goal_near", 2, -1.0, 1.0, f"goal centre, body frame [{NEAR:g} m], clipped"
        ),
        _GoalField(
            "goal_heading", 2, -1.0, 1.0, "cos and sin of goal heading minus own"
        ),
        _GoalField(
            "goal_distance",
            1,
            0.0,
            FARTHEST,
            f"to the goal centre [{FAR:g} m]",
            metres=FAR,
        ),
        _GoalField(
            "in_bay", 2, -1.0, 1.0, f"own centre, goal frame [{NEAR:g} m], clipped"
        ),
        _GoalField(
            "goal_size",
            2,
            0.0,
            2.0,
            f"length and width of the goal bay less own [{LENGTH:g} m]",
            metres=LENGTH,
        ),
    ),
    _goal,
)


def _lines(sight: Sight) -> dict[str, jax.Array]:
    layout, motion, goal = sight.layout, sight.motion, sight.goal
    goal_pose, goal_size = layout.bay_pose[goal], layout.bay_size[goal]
    room = box_room(motion.pose_w, motion.size, goal_pose, goal_size)
    return sight.with_goal({"line_room": jnp.clip(room / CLOSE, -1.0, 1.0)})


LINES = Part(
    (
        _GoalField(
            "line_room",
            4,
            -1.0,
            1.0,
            "room between the own outline and the goal bay's lines at +x, -x, +y, -y, "
            f"goal frame [{CLOSE:g} m], clipped",
        ),
    ),
    _lines,
)


def on_last_stretch(sight: Sight) -> jax.Array:
    """Whether routes turn no more before the goal, (num_observers,) bool."""
    goal_xy = sight.layout.bay_pose[sight.goal, :2]
    return (_route_left(sight).next_xy == goal_xy).all(axis=-1)


def _route_left(sight: Sight) -> RouteLeft:
    return route_to(sight.state.routes, sight.layout, sight.motion.xy, sight.goal)


def _route(sight: Sight) -> dict[str, jax.Array]:
    motion, route = sight.motion, _route_left(sight)
    position = rotate(route.next_xy - motion.xy, -motion.pose_w[..., 2])
    return {
        "route_next": far(position),
        "route_length": far(route.length[..., None]),
    }


ROUTE = Part(
    (
        _GoalField(
            "route_next",
            2,
            -FARTHEST,
            FARTHEST,
            f"where the route along the lanes turns next, body frame [{FAR:g} m]",
            metres=FAR,
        ),
        _GoalField(
            "route_length",
            1,
            0.0,
            FARTHEST,
            f"length of the route to the goal [{FAR:g} m]",
            metres=FAR,
        ),
    ),
    _route,
)


def _car(sight: Sight) -> dict[str, jax.Array]:
    vehicle = sight.vehicle
    radius = vehicle.wheelbase / jnp.tan(vehicle.max_steering)
    return {
        "own_size": sight.motion.size / LENGTH,
        "own_wheelbase": vehicle.wheelbase[..., None] / LENGTH,
        "own_rear_axle": vehicle.centre_offset[..., None] / LENGTH,
        "own_turning_radius": radius[..., None] / LENGTH,
    }


CAR = Part(
    (
        Field("own_size", 2, 0.0, 2.0, f"own length and width [{LENGTH:g} m]"),
        Field("own_wheelbase", 1, 0.0, 1.0, f"own wheelbase [{LENGTH:g} m]"),
        Field(
            "own_rear_axle", 1, 0.0, 1.0, f"from rear axle to own centre [{LENGTH:g} m]"
        ),
        Field(
            "own_turning_radius",
            1,
            0.0,
            2.0,
            f"of the rear axle, full lock [{LENGTH:g} m]",
        ),
    ),
    _car,
)


_LANE_FIELDS = (
    Field("lane_present", 1, 0.0, 1.0, "1 if the lot has lanes; else all 0"),
    Field("lane_heading", 2, -1.0, 1.0, "cos and sin of its heading minus own"),
    Field("lane_one_way", 1, 0.0, 1.0, "1 if only that direction is allowed"),
)


def _lane(sight: Sight) -> dict[str, jax.Array]:
    """Of the lane nearest to every agent; zeros without lanes."""
    layout, own_pose = sight.layout, sight.motion.pose_w
    if not has_lanes(layout):
        count = own_pose.shape[0]
        return {field.name: jnp.zeros((count, field.size)) for field in _LANE_FIELDS}
    index, present = nearest_lane(layout, own_pose)
    yaw = layout.lane_pose[index, 2] - own_pose[:, 2]
    values = {
        "lane_present": present[:, None],
        "lane_heading": jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1),
        "lane_one_way": layout.lane_one_way[index, None],
    }
    return {
        name: jnp.where(present[:, None], value, 0.0) for name, value in values.items()
    }


LANE = Part(_LANE_FIELDS, _lane)

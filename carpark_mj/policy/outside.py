"""A lot as one car outside the simulator knows it: from plain inputs and to them.

A lot is built from the inputs. The car outside is its first and only observing agent,
so the environment's code computes the observation.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry.obstacles import by_shape, merge
from carpark_mj.layouts.routes import make_routes
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.parked_cars import place_absent_agents
from carpark_mj.observations import Sight
from carpark_mj.observations.ego import goal_code
from carpark_mj.observations.sensors import observed
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.policy.plain_inputs import INPUTS, Rows
from carpark_mj.types import NO_BAY, Motion, ParkedCars, State


class _Car(NamedTuple):
    """What observations read of `Vehicle` (cars,)."""

    size: jax.Array
    wheelbase: jax.Array
    centre_offset: jax.Array
    max_speed: jax.Array
    max_steering: jax.Array


class _Physics(NamedTuple):
    vehicle: Any


def sight_of(rows: Rows, given: Mapping[str, jax.Array]) -> Sight:
    """The view of a car from all of `INPUTS`, by name."""

    def cars(name: str) -> jax.Array:
        """Of the own car, then of the others; zeros if these do not communicate."""
        own = given[name][None]
        none = jnp.zeros((rows.others, *own.shape[1:]))
        return jnp.concatenate([own, given.get(f"other_{name}", none)])

    present = jnp.concatenate([jnp.ones(1, bool), given["other_mask"]])
    pose, speed = place_absent_agents(cars("pose"), present), cars("speed")
    motion = Motion(
        pose_w=pose,
        velocity_b=jnp.stack([speed, jnp.zeros_like(speed)], axis=-1),
        yaw_rate=cars("yaw_rate"),
        steering=cars("steering"),
        size=cars("size"),
        trace_w=pose[:, None],
        finite=present,
    )
    car = _Car(
        size=motion.size,
        wheelbase=cars("wheelbase"),
        centre_offset=cars("rear_axle"),
        max_speed=cars("max_speed"),
        max_steering=cars("max_steering"),
    )
    layout = _layout(rows, given)
    if rows.bays:
        number = jnp.arange(rows.bays, dtype=jnp.int32)
        tracked_bays = jnp.where(given["bay_mask"], number, NO_BAY)[None]
        choice = jnp.concatenate([given["choice"][None], given["other_choice"]])
        goal, routes = jnp.where(choice == 0, NO_BAY, choice - 1), None
    else:
        goal, tracked_bays = jnp.arange(1 + rows.others, dtype=jnp.int32), None
        routes = make_routes(_only_goal(layout))
    parked = jnp.where(given["parked_mask"], jnp.arange(rows.parked), NO_BAY)
    unread: Any = None
    state = State(
        physics=_Physics(car),
        motion=motion,
        layout=layout,
        goal=goal,
        tracked_bays=tracked_bays,
        parked_cars=ParkedCars(parked, given["parked_pose"], given["parked_size"]),
        memory=unread,
        step=unread,
        active=unread,
        stats=unread,
        sensors=None,
        key=unread,
        present=present,
        routes=routes,
    )
    before = jnp.concatenate([jnp.zeros(1, bool), given["other_priority"]])
    return Sight(state, motion, num_observers=1, number=-before.astype(jnp.int32))


def _layout(rows: Rows, given: Mapping[str, jax.Array]) -> Layout:
    """The plan: the own goal and those of the others, or the tracked bays and one."""
    if rows.bays:
        pose, size, end = given["bay_pose"], given["bay_size"], given["bay_end"]
        beyond = jnp.zeros((1, 3))  # goal of others that the car does not track
    else:
        pose, size = given["goal_pose"][None], given["goal_size"][None]
        end = given["goal_end"][None]
        beyond = jnp.pad(given["other_goal"], ((0, 0), (0, 1)))
    pose, more = jnp.concatenate([pose, beyond]), beyond.shape[0]
    none = jnp.zeros((0, 3))
    return Layout(
        bay_pose=pose,
        bay_size=jnp.pad(size, ((0, more), (0, 0))),
        bay_kind=jnp.zeros(pose.shape[0], jnp.int32),
        bay_mask=jnp.ones(pose.shape[0], bool),
        wall_pose=given["wall_pose"],
        wall_size=given["wall_size"],
        wall_kind=jnp.zeros(rows.walls, jnp.int32),
        wall_mask=given["wall_mask"],
        disc_centre=given["disc_centre"],
        disc_radius=given["disc_radius"],
        disc_kind=jnp.zeros(rows.discs, jnp.int32),
        disc_mask=given["disc_mask"],
        lane_pose=given["lane_pose"],
        lane_size=given["lane_size"],
        lane_one_way=given["lane_one_way"],
        lane_mask=given["lane_mask"],
        spawn_pose=none,
        spawn_size=none[:, :2],
        spawn_spread=none[:, 0],
        spawn_mask=none[:, 0] > 0.0,
        extent=jnp.zeros(2),
        bay_end=jnp.pad(end, (0, more)) if rows.bay_ends else None,
    )


def _only_goal(layout: Layout) -> Layout:
    """The layout with the first bay alone, the own goal."""
    return dataclasses.replace(
        layout,
        bay_pose=layout.bay_pose[:1],
        bay_size=layout.bay_size[:1],
        bay_mask=layout.bay_mask[:1],
    )


def plain_values(rows: Rows, state: State) -> dict[str, jax.Array]:
    """The inputs of every agent of a lot by name, (num_agents, *shape).

    Args:
        rows: at least as many as the lot has.
        state: of the lot. Inputs are the sensors' measurements.
    """
    motion, car, layout = observed(state), state.physics.vehicle, state.layout
    count, goal, bays = state.goal.shape[0], state.goal, state.tracked_bays
    agent, other = jnp.arange(count)[:, None], jnp.arange(count - 1)
    other = other + (other >= agent)  # (num_agents, others)
    present = jnp.ones(count, bool) if state.present is None else state.present
    values: dict[str, jax.Array] = {
        "pose": motion.pose_w,
        "speed": motion.speed,
        "yaw_rate": motion.yaw_rate,
        "steering": motion.steering,
        "size": motion.size,
        "wheelbase": car.wheelbase,
        "rear_axle": car.centre_offset,
        "max_speed": car.max_speed,
        "max_steering": car.max_steering,
    }
    told = ("pose", "size", "speed", "steering", "max_steering")
    values |= {f"other_{name}": values[name][other] for name in told}
    values |= {"other_mask": present[other], "other_priority": other < agent}
    end = jnp.zeros_like(layout.bay_kind) if layout.bay_end is None else layout.bay_end
    if bays is None:
        kind, which = "goal", goal
        values["other_goal"] = layout.parked_pose[goal][other, :2]
    else:
        kind, which = "bay", bays
        values["bay_mask"] = bays != NO_BAY
        values["choice"] = goal_code(goal[:, None], bays)[:, 0]
        values["other_choice"] = goal_code(goal[other], bays)
    values |= {
        f"{kind}_pose": layout.bay_pose[which],
        f"{kind}_size": layout.bay_size[which],
        f"{kind}_end": end[which],
    }
    values |= {
        name: jnp.broadcast_to(value, (count, *value.shape))
        for name, value in _lot_values(state).items()
    }
    return {
        x.name: _pad(values[x.name], x.shape(rows))
        for x in INPUTS
        if x.name in values and 0 not in x.shape(rows)
    }


def _lot_values(state: State) -> dict[str, jax.Array]:
    """The inputs that are the same for all agents."""
    layout, parked_cars = state.layout, state.parked_cars
    there = lot_obstacles(layout, None, parked_cars, state.movers)
    solid = [group for group in there if group.kind != ObstacleKind.PARKED_CAR]
    walls, discs = (merge(same, num_agents=1) for same in by_shape(solid))
    return {
        "parked_pose": parked_cars.pose_w,
        "parked_size": parked_cars.size,
        "parked_mask": parked_cars.present,
        "wall_pose": walls.group.pose_w,
        "wall_size": walls.group.size,
        "wall_mask": walls.counts[0],
        "disc_centre": discs.group.pose_w,
        "disc_radius": discs.group.size,
        "disc_mask": discs.counts[0],
        "lane_pose": layout.lane_pose,
        "lane_size": layout.lane_size,
        "lane_one_way": layout.lane_one_way,
        "lane_mask": layout.lane_mask,
    }


def _pad(value: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """Values (num_agents, ...) as (num_agents, *shape), with zeros behind."""
    missing = zip(shape, value.shape[1:], strict=True)
    return jnp.pad(value, [(0, 0), *((0, most - own) for most, own in missing)])

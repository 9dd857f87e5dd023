"""What agents observe of the other cars they track."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp

from carpark_mj.config.observations import ShareConfig
from carpark_mj.geometry import to_local
from carpark_mj.observations.bay_fields import goal_code
from carpark_mj.observations.fields import (
    FAR,
    FARTHEST,
    Field,
    far,
    repeated,
    repeated_values,
)
from carpark_mj.observations.localised import CAR_FIELDS, localise
from carpark_mj.observations.parts import Part, Sight
from carpark_mj.observations.tracking import track_agents, track_parked_cars
from carpark_mj.types import NO_BAY, ParkedCars

# Values (num_agents, count, k) of the agents (num_agents, count) that each tracks.
Shared = Callable[[Sight, jax.Array], jax.Array]


def agents_part(count: int, share: ShareConfig, num_tracked_bays: int) -> Part:
    """The nearest other agents.

    Args:
        count: how many.
        share: what is observed of them in addition to their poses.
        num_tracked_bays: from which agents choose their goals; 0 = they are fixed.
    """
    shared = _shared(share, num_tracked_bays)

    def fill(sight: Sight) -> dict[str, jax.Array]:
        agents, present = sight.agents, sight.state.present
        index, present = track_agents(
            count, agents.pose_w, present, sight.num_observers
        )
        pose, size = agents.pose_w[index], agents.size[index]
        values = localise(sight.motion.pose_w, pose, size, present)
        for field, find in shared:
            values[field.name] = jnp.where(present[..., None], find(sight, index), 0.0)
        return repeated_values("agent", values)

    fields = repeated("agent", count, [*CAR_FIELDS, *(field for field, _ in shared)])
    return Part(tuple(fields), fill)


def parked_cars_part(count: int) -> Part:
    """The nearest `count` parked cars."""

    def fill(sight: Sight) -> dict[str, jax.Array]:
        own_pose = sight.motion.pose_w
        cars = _at_least_one(sight.state.parked_cars)
        index, present = track_parked_cars(count, own_pose, cars)
        values = localise(own_pose, cars.pose_w[index], cars.size[index], present)
        return repeated_values("parked_car", values)

    return Part(tuple(repeated("parked_car", count, CAR_FIELDS)), fill)


def _shared(share: ShareConfig, num_tracked_bays: int) -> list[tuple[Field, Shared]]:
    """What tracked agents share."""
    shared: list[tuple[Field, Shared]] = []
    if share.speeds:
        meaning = "its signed speed [own forward limit]"
        speed = Field("speed", 1, -1.5, 1.5, meaning, speed=math.inf)
        shared.append((speed, _speed))
    if share.goals and num_tracked_bays:
        meaning = "one-hot: it explores, its goal's place among the own bays, none"
        shared.append(
            (Field("goal", num_tracked_bays + 2, 0, 1, meaning), _goal_choice)
        )
    elif share.goals:
        meaning = f"centre of its goal, body frame [{FAR:g} m]"
        goal = Field("goal", 2, -FARTHEST, FARTHEST, meaning, metres=FAR)
        shared.append((goal, _goal))
    if share.steering:
        meaning = "its road-wheel angle [its limit], left > 0"
        shared.append((Field("steering", 1, -1.0, 1.0, meaning), _steering))
    if share.priority:
        meaning = "1 if its number in the lot is lower than the own, else 0"
        shared.append((Field("priority", 1, 0.0, 1.0, meaning), _priority))
    return shared


def _speed(sight: Sight, index: jax.Array) -> jax.Array:
    max_speed = sight.vehicle.max_speed
    return (sight.agents.speed[index] / max_speed[:, None])[..., None]


def _goal_choice(sight: Sight, index: jax.Array) -> jax.Array:
    bays = sight.tracked_bays
    goal = sight.state.goal[index]
    return jax.nn.one_hot(goal_code(goal, bays), bays.shape[1] + 2)


def _goal(sight: Sight, index: jax.Array) -> jax.Array:
    goal_pose = sight.layout.parked_pose[sight.state.goal]
    local = to_local(sight.motion.pose_w[:, None], goal_pose[index])
    return far(local[..., :2])


def _steering(sight: Sight, index: jax.Array) -> jax.Array:
    steering = sight.agents.steering / sight.state.physics.vehicle.max_steering
    return steering[index][..., None]


def _priority(sight: Sight, index: jax.Array) -> jax.Array:
    number, count = sight.number, index.shape[0]
    own = jnp.arange(count) if number is None else number[:count]
    before = (index if number is None else number[index]) < own[:, None]
    return before[..., None].astype(jnp.float32)


def _at_least_one(parked_cars: ParkedCars) -> ParkedCars:
    """The parked cars; one that is absent keeps the shapes where there are none."""
    if parked_cars.bay.shape[0]:
        return parked_cars
    return ParkedCars(
        bay=jnp.full(1, NO_BAY), pose_w=jnp.zeros((1, 3)), size=jnp.zeros((1, 2))
    )

"""What agents observe of the nearest cars, people and other movers."""

import dataclasses
import functools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import CheckedConfig
from carpark_mj.geometry import nearest, norm, rotate, to_local
from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind
from carpark_mj.observations.ego import goal_code
from carpark_mj.observations.fields import (
    ASIDE,
    CAR_FIELDS,
    Field,
    ObservationInput,
    Part,
    far,
    localise,
    position_field,
    repeated,
    repeated_values,
)
from carpark_mj.types import NO_BAY, ParkedCars


@dataclasses.dataclass(frozen=True)
class ShareConfig(CheckedConfig):
    """Observed properties of tracked agents in addition to their poses.

    Attributes:
        speeds: observe the speeds of tracked agents.
        goals: observe the goals of tracked agents: positions of fixed goals, and which
            of the observer's tracked bays a dynamic goal is.
        steering: observe the steering of tracked agents.
        priority: observe which tracked agents have a lower number in the lot, so that
            two agents of one policy that meet can act differently.
    """

    speeds: bool = True
    goals: bool = True
    steering: bool = False
    priority: bool = False


def track_agents(
    count: int,
    pose: jax.Array,
    present: jax.Array | None = None,
    num_observers: int | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The `count` agents nearest to each of the first `num_observers`; None = all.

    Poses are (num_agents, 3), `present` (num_agents,) is `State.present`. Returns
    indices and presence (num_observers, count), see `geometry.nearest`.
    """
    xy, others = pose[:, :2], other_agents(pose.shape[0], present)
    return nearest(xy[:num_observers], xy, others[:num_observers], count)


def track_parked_cars(
    count: int, own_pose: jax.Array, parked_cars: ParkedCars
) -> tuple[jax.Array, jax.Array]:
    """The `count` parked cars nearest to each of the observers (num_agents, 3).

    Returns indices and presence (num_agents, count), see `geometry.nearest`.
    """
    xy, present = parked_cars.pose_w[:, :2], parked_cars.present
    mask = jnp.broadcast_to(present, (own_pose.shape[0], *present.shape))
    return nearest(own_pose[:, :2], xy, mask, count)


def other_agents(count: int, present: jax.Array | None) -> jax.Array:
    """(count, count) bool, [i, j] whether j is another agent and present."""
    others = ~jnp.eye(count, dtype=bool)
    return others if present is None else others & present


def mark(index: jax.Array, present: jax.Array, count: int) -> jax.Array:
    """Which of `count` are tracked, (num_agents, count) bool, by `geometry.nearest`."""
    same = index[..., None] == jnp.arange(count)
    return jnp.any(same & present[..., None], axis=1)


# Values (num_agents, count, k) of the agents (num_agents, count) that each tracks.
Shared = Callable[[ObservationInput, jax.Array], jax.Array]


@functools.cache
def agents_part(count: int, share: ShareConfig, num_tracked_bays: int) -> Part:
    """The nearest `count` other agents, with what they share.

    `num_tracked_bays` is the number from which agents choose goals; 0 = fixed goals.
    """
    shared = _shared(share, num_tracked_bays)

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        agents, there, n = sight.agents, sight.state.present, sight.num_observers
        index, present = track_agents(count, agents.pose_w, there, n)
        pose, size = agents.pose_w[index], agents.size[index]
        values = localise(sight.motion.pose_w, pose, size, present)
        for field, find in shared:
            values[field.name] = jnp.where(present[..., None], find(sight, index), 0.0)
        return repeated_values("agent", values)

    fields = repeated("agent", count, [*CAR_FIELDS, *(field for field, _ in shared)])
    return Part(tuple(fields), fill)


@functools.cache
def parked_cars_part(count: int) -> Part:
    """The nearest `count` parked cars."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        own_pose = sight.motion.pose_w
        cars = sight.state.parked_cars
        if not cars.bay.shape[0]:  # an absent one keeps the shapes
            pose, size = jnp.zeros((1, 3)), jnp.zeros((1, 2))
            cars = ParkedCars(bay=jnp.full(1, NO_BAY), pose_w=pose, size=size)
        index, present = track_parked_cars(count, own_pose, cars)
        values = localise(own_pose, cars.pose_w[index], cars.size[index], present)
        return repeated_values("parked_car", values)

    return Part(tuple(repeated("parked_car", count, CAR_FIELDS)), fill)


_SPEED = "its signed speed [own forward limit]"
_ANGLE = "its road-wheel angle [its limit], left > 0"
_PLACE = "one-hot: it explores, its goal's place among the own bays, none"
_BEFORE = "1 if its number in the lot is lower than the own, else 0"


def _shared(share: ShareConfig, num_tracked_bays: int) -> list[tuple[Field, Shared]]:
    """What tracked agents share."""
    speed = Field("speed", 1, -1.5, 1.5, _SPEED, speed=math.inf)
    steering = Field("steering", 1, -1.0, 1.0, _ANGLE, mirror=(-1,))
    goal = position_field("goal", "centre of its goal"), _shared_goal
    if num_tracked_bays:
        goal = Field("goal", num_tracked_bays + 2, 0, 1, _PLACE), _goal_choice
    rows = (
        (share.speeds, speed, _speed),
        (share.goals, *goal),
        (share.steering, steering, _steering),
        (share.priority, Field("priority", 1, 0.0, 1.0, _BEFORE), _priority),
    )
    return [(field, find) for shares, field, find in rows if shares]


def _speed(sight: ObservationInput, index: jax.Array) -> jax.Array:
    max_speed = sight.vehicle.max_speed
    return (sight.agents.speed[index] / max_speed[:, None])[..., None]


def _goal_choice(sight: ObservationInput, index: jax.Array) -> jax.Array:
    bays = sight.tracked_bays
    goal = sight.state.goal[index]
    return jax.nn.one_hot(goal_code(goal, bays), bays.shape[1] + 2)


def _shared_goal(sight: ObservationInput, index: jax.Array) -> jax.Array:
    goal_pose = sight.layout.parked_pose[sight.state.goal]
    local = to_local(sight.motion.pose_w[:, None], goal_pose[index])
    return far(local[..., :2])


def _steering(sight: ObservationInput, index: jax.Array) -> jax.Array:
    steering = sight.agents.steering / sight.state.physics.vehicle.max_steering
    return steering[index][..., None]


def _priority(sight: ObservationInput, index: jax.Array) -> jax.Array:
    number, count = sight.number, index.shape[0]
    own = jnp.arange(count) if number is None else number[:count]
    before = (index if number is None else number[index]) < own[:, None]
    return before[..., None].astype(jnp.float32)


PACE = 2.0  # m/s, scale of their velocities
STANDS = 0.05  # m/s, below which a velocity has no direction
_VELOCITY = f"its velocity, body frame [{PACE:g} m/s]"
_MOVER_FIELDS = (
    *CAR_FIELDS,
    Field("velocity", 2, -3.0, 3.0, _VELOCITY, speed=PACE, mirror=ASIDE),
    Field("person", 1, 0.0, 1.0, "1 if it is a person, else 0"),
)


@functools.cache
def movers_part(count: int) -> Part:
    """The nearest `count` movers."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        own, groups = sight.motion, sight.state.movers.groups
        pose, size, velocity, there, person, round_ = _table(groups)
        mask = jnp.broadcast_to(there, (own.xy.shape[0], *there.shape))
        index, present = nearest(own.xy, pose[:, :2], mask, count)
        # A mover that stands without a heading gets the observer's heading.
        still = (norm(velocity) < STANDS) & round_
        yaw = jnp.where(still[index], own.pose_w[:, None, 2], pose[index, 2])
        seen = jnp.concatenate([pose[index, :2], yaw[..., None]], axis=-1)
        values = localise(own.pose_w, seen, size[index], present)
        way = rotate(velocity[index], -own.pose_w[:, None, 2])
        more = {"velocity": way / PACE, "person": person[index][..., None]}
        more = {k: jnp.where(present[..., None], x, 0.0) for k, x in more.items()}
        return repeated_values("mover", values | more)

    return Part(tuple(repeated("mover", count, _MOVER_FIELDS)), fill)


def _table(groups: tuple[Group, ...]) -> tuple[jax.Array, ...]:
    """Poses, sizes, velocities, masks, and whether persons and discs, (n, ...)."""
    rows = []
    for group in groups:
        pose, size, velocity, there = group.as_boxes
        is_disc = not isinstance(group, Boxes)
        if is_disc:
            yaw = jnp.arctan2(velocity[:, 1], velocity[:, 0])
            pose = jnp.concatenate([pose[:, :2], yaw[:, None]], axis=1)
        person = jnp.full(group.count, float(group.kind == ObstacleKind.PERSON))
        disc = jnp.full(group.count, is_disc)
        rows.append((pose, size, velocity, there, person, disc))
    if not rows:
        nobody = jnp.zeros((1, 3)), jnp.zeros((1, 2)), jnp.zeros((1, 2))
        return *nobody, jnp.zeros(1, bool), jnp.zeros(1), jnp.zeros(1, bool)
    return tuple(jnp.concatenate(column) for column in zip(*rows, strict=True))

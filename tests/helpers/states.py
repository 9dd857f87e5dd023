"""States of a lot by hand, without an environment."""

import collections

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config import EnvConfig, GoalConfig
from carpark_mj.types import NO_BAY, EpisodeStats, ParkedCars, State


def array_module(*values):
    """NumPy, in which a scene by hand compiles nothing, or JAX for traced values."""
    traced = any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(values))
    return jnp if traced else np


CAR = {
    "wheelbase": 2.5,
    "centre_offset": 1.25,
    "max_speed": 3.0,
    "max_reverse_speed": 2.0,
    "max_steering": 0.6,
    "steering_rate": 0.5,
    "wheel_radius": 0.3,
    "track_width": 1.5,
    "max_acceleration": 2.0,
    "max_deceleration": 4.0,
}
# What the task reads of `carpark_mj.vehicle.Vehicle`, (num_agents,).
HandCar = collections.namedtuple("HandCar", ("size", *CAR))


@struct.dataclass
class HandPhysics:
    """A physics state that holds nothing but the cars' parameters."""

    vehicle: HandCar


def hand_cars(motion, **parameters):
    """Parameters of the cars of a motion; scalars hold for all of them."""
    values = CAR | parameters
    lead, xp = motion.yaw_rate.shape, array_module(values)
    full = {
        name: jnp.asarray(xp.broadcast_to(xp.asarray(value, np.float32), lead))
        for name, value in values.items()
    }
    return HandCar(size=motion.size, **full)


def parked_at(pose=(), size=(4.0, 2.0), present=True):
    """Parked cars at poses (num_parked_cars, 3), in the first bays of the lot."""
    xp = array_module(pose, size, present)
    pose = xp.asarray(pose, np.float32).reshape(-1, 3)
    bay = xp.arange(pose.shape[0], dtype=np.int32)
    cars = ParkedCars(
        bay=xp.where(xp.asarray(present), bay, np.int32(NO_BAY)),
        pose_w=pose,
        size=xp.broadcast_to(xp.asarray(size, np.float32), (pose.shape[0], 2)),
    )
    return jax.tree.map(jnp.asarray, cars)


def parked_in(layout, bay, size=(4.0, 2.0)):
    """Parked cars in the middle of bays (num_parked_cars,) of a lot."""
    xp = array_module(layout, bay)
    bay = xp.asarray(bay, np.int32)
    # As in JAX, no bay stands for the last.
    pose = xp.asarray(layout.bay_pose)[xp.minimum(bay, layout.num_bays - 1)]
    return parked_at(pose, size).replace(bay=jnp.asarray(bay))


def state_of(layout, motion, goal, **changes):
    """A state by hand: nobody parked, goals fixed, true sensors, at the first step.

    `goal` is (num_agents,) bays, or one for all; `changes` are other attributes.
    """
    lead = motion.yaw_rate.shape
    if changes.get("tracked_bays") is not None:
        changes["tracked_bays"] = jnp.asarray(changes["tracked_bays"], jnp.int32)
    zero, xp = jnp.asarray(np.zeros(lead, np.float32)), array_module(goal)
    stats = EpisodeStats(
        episode_return=zero,
        length=zero,
        path=zero,
        gear_changes=zero,
        direction=zero,
        invalid_actions=zero,
        wrong_way=None,
        tallies={},
    )
    state = State(
        physics=HandPhysics(hand_cars(motion)),
        motion=motion,
        layout=layout,
        goal=jnp.asarray(xp.broadcast_to(xp.asarray(goal, np.int32), lead)),
        tracked_bays=None,
        parked_cars=parked_at(),
        memory=None,
        step=jnp.asarray(np.zeros(lead, np.int32)),
        active=jnp.asarray(np.ones(lead, bool)),
        stats=stats,
        sensors=None,
        key=jax.random.key(0),
    )
    return state.replace(**changes)


def config_of(observation, num_tracked_bays=0, **settings):
    """An environment of kinematic cars; without tracked bays its goals are fixed.

    It has agents enough for all slots of the default observation.
    """
    settings = {"num_agents": 7, "physics": "bicycle"} | settings
    goals = GoalConfig(num_tracked_bays > 0, max(num_tracked_bays, 1))
    return EnvConfig(observation=observation, goals=goals, **settings)


def any_hit(hits):
    """(num_agents,) bool, who touched anything; `hits` as of `find_hits`."""
    return jnp.any(jnp.stack([*hits.values()]), axis=0)

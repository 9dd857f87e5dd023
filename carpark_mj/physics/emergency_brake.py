"""Automatic emergency braking for people, as cars have it (UN R152).

A car brakes fully in a step if what its driver commands would bring it so near to a
person that it could not stop before them afterwards. It reads true positions, as a
perfect sensor would. The steering is held while it brakes, so that the car stays on
the way that was looked at. It brakes for a danger that the car makes: who comes nearer
to a car that stands or drives away does not matter.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import SimConfig
from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import move_forward
from carpark_mj.geometry.obstacles import Group
from carpark_mj.types import Motion, State
from carpark_mj.vehicle.conditions import in_conditions
from carpark_mj.vehicle.drive import stopping_action
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import Vehicle

PROTECTED = (ObstacleKind.PERSON,)
ASIDE = 0.15  # m, gap beside the swept area within which somebody is in danger [est]
NEARER = 0.9  # of the present gap: what keeps more of it does not approach
LEAST = 0.1  # m/s², assumed of brakes that do not hold the car on its slope
WIDER = 0.8  # of the steering's curvature: cars turn wider the faster they are [est]
PLACES, ARCS = 4, 3  # looked at along a way, and ways between two steering angles


def override(sim: SimConfig, state: State, controls: jax.Array) -> jax.Array:
    """Controls (num_agents, 2) that brake and hold the steering near people in danger.

    Args:
        sim: with a positive `emergency_brake`.
        state: of the lot, at the start of the control step.
        controls: steer and pedal in [-1, 1] that drivers command.
    """
    groups = [group for group in state.movers.groups if group.kind in PROTECTED]
    if not groups:
        return controls
    with jax.named_scope("emergency_brake"):
        car = in_conditions(state.physics.vehicle, sim)
        pose, time = sweep(sim, car, state.motion, controls)
        found = [endangered(state.motion, pose, time, group) for group in groups]
        stop = stopping_action(state.motion.speed)[:, 1]
        danger = jnp.stack(found).any(axis=0)
        held = state.motion.steering / car.max_steering
        steer = jnp.where(danger, held, controls[:, 0])
        pedal = jnp.where(danger, stop, controls[:, 1])
        return jnp.stack([steer, pedal], axis=-1)


def stopping_way(
    sim: SimConfig, car: Vehicle, speed: jax.Array, pedal: jax.Array, limit: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Way (...) [m] and time (...) [s] of cars that obey for a step and then brake.

    Args:
        sim: time steps, delays, slopes and the gap to keep, which is part of the way of
            a car that moves.
        car: their parameters.
        speed: in the direction looked at [m/s]; cars that move the other way stand.
        pedal: in [-1, 1], positive in that direction.
        limit: speed up to which the pedal drives [m/s].
    """
    by_load, climb = car.rated_mass / car.mass, GRAVITY * sim.steepest
    grip = car.tyres.friction * GRAVITY
    decel = jnp.minimum(car.max_deceleration * by_load, grip) - climb
    decel = jnp.maximum(decel, LEAST)
    idle = 0.0 if car.creep is None else car.creep
    push = jnp.maximum(pedal * car.max_acceleration, idle) * by_load + climb
    change = jnp.where(pedal < 0.0, pedal * decel, push) * sim.ctrl_dt
    before = jnp.maximum(speed, 0.0)
    after = jnp.clip(before + change, 0.0, jnp.maximum(before, limit))
    way = (before + after) / 2 * sim.ctrl_dt + after * after / (2 * decel)
    way = way + after * sim.pedal_delay
    gap = jnp.where(after > 0.0, sim.emergency_brake, 0.0)
    return way + gap, sim.ctrl_dt + sim.pedal_delay + after / decel


def sweep(
    sim: SimConfig, car: Vehicle, motion: Motion, controls: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Where cars (n,) come until they stand, on arcs between two steering angles.

    The angles are the present one and that of the next step, when the steering is held.

    Returns:
        Poses (n, k, 3) of their centres and the times (n, k) at which they are there
        [s].
    """
    steer, pedal = controls[:, 0], controls[:, 1]
    ahead = stopping_way(sim, car, motion.speed, pedal, car.max_speed)
    behind = stopping_way(sim, car, -motion.speed, -pedal, car.max_reverse_speed)
    forwards = ahead[0] >= behind[0]
    way = jnp.where(forwards, ahead[0], -behind[0])
    duration = jnp.where(forwards, ahead[1], behind[1])
    turn = jnp.clip(steer, -1.0, 1.0) * car.max_steering - motion.steering
    # The steering is obeyed for a step, and held while the car brakes.
    most = car.steering_rate * (sim.ctrl_dt + sim.steering_delay)
    turn = jnp.clip(turn, -most, most)
    now = jnp.tan(motion.steering) / car.wheelbase
    soon = jnp.tan(motion.steering + turn) / car.wheelbase
    low, high = jnp.minimum(now, soon), jnp.maximum(now, soon)
    low, high = jnp.minimum(low, WIDER * low), jnp.maximum(high, WIDER * high)
    part = jnp.linspace(0.0, 1.0, ARCS)
    curvature = low[:, None] + (high - low)[:, None] * part
    share = (jnp.arange(PLACES) + 1.0) / PLACES
    along = way[:, None, None] * share
    half_turn = along * curvature[..., None] / 2
    axle = move_forward(motion.pose_w, -car.centre_offset)[:, None, None]
    # The chord of an arc, to the third order.
    chord = along * (1.0 - half_turn * half_turn / 6.0)
    yaw = axle[..., 2] + half_turn
    x, y = axle[..., 0] + chord * jnp.cos(yaw), axle[..., 1] + chord * jnp.sin(yaw)
    pose = jnp.stack([x, y, yaw + half_turn], axis=-1)
    pose = move_forward(pose, car.centre_offset[:, None, None])
    time = jnp.broadcast_to(duration[:, None, None] * share, half_turn.shape)
    count = way.shape[0]
    return pose.reshape(count, -1, 3), time.reshape(count, -1)


def endangered(
    motion: Motion, pose: jax.Array, time: jax.Array, group: Group
) -> jax.Array:
    """Whether cars (n,) bool would come too near to one of a group.

    Somebody is looked for where they are and where they will be at their velocity.

    Args:
        motion: of the cars, as they are.
        pose: (n, k, 3) where they would come.
        time: (n, k) when [s].
        group: obstacles (m,).
    """
    here, size = motion.pose_w[:, None, None], motion.size[:, None, None]

    def near(others: Group) -> jax.Array:
        gap = others.distance(pose[:, :, None], size)
        return (gap < ASIDE) & (gap < NEARER * others.distance(here, size))

    found = near(group)
    if group.velocity_w is not None:
        way = group.velocity_w * time[..., None, None]
        way = jnp.pad(way, ((0, 0),) * 3 + ((0, group.pose_w.shape[-1] - 2),))
        found = found | near(dataclasses.replace(group, pose_w=group.pose_w + way))
    counts = group.counts(motion.size.shape[0])[:, None]
    return (found & counts).any(axis=(1, 2))

"""Automatic braking: for people and vehicles (UN R152), and in manoeuvres.

A car brakes, as hard as it must to stop within a step or as it can, if obeying its
driver for a step would bring it so near to a person, a mover or another agent's car
that it could not stop afterwards. True positions are read, as by a perfect sensor.
Braking in manoeuvres is for parked cars and walls.

The footprint is swept along the way that obeys the pedal for a step and then brakes
fully, and along the gap, on three arcs between the present steering angle and that of
the next step, the outer one a fifth less curved. Load, grip, slopes, `drive_lag`,
`creep` and `pedal_delay` count, but not commands that are under way. Where full brakes
lock the wheels, the car slides on from the velocity of its centre, drifts down the
slope, and keeps its heading or turns on. It brakes if one of them, at present or where
the velocity leads meanwhile, is within `ASIDE` of the sweep, twice that in a slide, and
nearer by a tenth than at present: who approaches a car that stands or drives away does
not count. The steering is held while it brakes, so that the swept area stays valid. For
parked cars and walls all gaps are `manoeuvre_brake`, and a car that stands may steer.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import SimConfig
from carpark_mj.geometry.obstacles import Group, ObstacleKind
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import Motion, State
from carpark_mj.vehicle.drive import HOLD_PEDAL, HOLD_SPEED
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import Vehicle, in_conditions

# m, gaps beside the swept area of danger, twice where cars slide [est].
_VEHICLES = ObstacleKind.AGENT, ObstacleKind.DRIVER, ObstacleKind.MOVER
ASIDE = dict.fromkeys(_VEHICLES, 0.05) | {ObstacleKind.PERSON: 0.15}
STATIC = ObstacleKind.PARKED_CAR, ObstacleKind.WALL
STANDING = 0.05  # m/s; slower cars are left to the holding brake, and may steer [est]
NEARER = 0.9  # of the present gap: what keeps more of it does not approach
LEAST = 0.1  # m/s², assumed of brakes that do not hold the car on its slope
WIDER = 0.8  # of the steering's curvature: cars turn wider the faster they are [est]
SLIPPING = 0.1  # m/s; slower cars are taken to move where they head
ARCS = 3  # ways between two steering angles
SHARE = np.array([1, 4, 9, 16], np.float32) / 16  # of a way, the places looked at
# Of g T², the drift across a slope g of a car that slides for T to a stop, by the share
# s of its way: friction opposes the velocity, so that dv/dt = g - v / (T - t).
DRIFT = (SHARE + (1.0 - SHARE) * np.log(np.maximum(1.0 - SHARE, 1e-9))) / 4


def override(sim: SimConfig, state: State, controls: jax.Array) -> jax.Array:
    """Controls (num_agents, 2) that brake and hold the steering where there is danger.

    From the lot at the start of a control step and what drivers command, steer and
    pedal in [-1, 1]. Of `sim` a positive `emergency_brake` or `manoeuvre_brake` counts.
    """
    motion = state.motion
    there = lot_obstacles(state.layout, motion, state.parked_cars, state.movers)
    alone = motion.yaw_rate.shape[0] == 1
    others = [x for x in there if x.kind in ASIDE and not (alone and x is there[0])]
    with jax.named_scope("emergency_brake"):
        car = in_conditions(state.physics.vehicle, sim)
        held, pedal = motion.steering / car.max_steering, stop(sim, car, motion)

        def braked(sim: SimConfig, near: list[tuple[Group, float]], steer: jax.Array):
            swept = sweep(sim, car, motion, controls)
            wider = jnp.where(sliding(car), 2.0, 1.0)
            found = [endangered(motion, swept, wider * gap, x) for x, gap in near]
            danger = jnp.stack(found).any(axis=0)[:, None]
            return jnp.where(danger, jnp.stack([steer, pedal], axis=-1), controls)

        if sim.emergency_brake and others:
            controls = braked(sim, [(x, ASIDE[x.kind]) for x in others], held)
        if sim.manoeuvre_brake:
            stands = jnp.abs(motion.speed) < STANDING
            near = [(x, sim.manoeuvre_brake) for x in there if x.kind in STATIC]
            no_gap = dataclasses.replace(sim, emergency_brake=0.0)
            controls = braked(no_gap, near, jnp.where(stands, controls[:, 0], held))
        return controls


def sliding(car: Vehicle) -> jax.Array:
    """Whether full brakes lock the wheels of cars (...), which then slide."""
    return (
        car.max_deceleration * car.rated_mass / car.mass > car.tyres.friction * GRAVITY
    )


def stop(sim: SimConfig, car: Vehicle, motion: Motion) -> jax.Array:
    """Pedals (n,) in [-1, 1] that stop cars within a step, or brake fully.

    Cars that slide brake fully. The holding brake, which closes in half a second, is
    left to hold.
    """
    gear, speed = jnp.sign(motion.speed), jnp.abs(motion.speed)
    slides, decel = sliding(car), car.max_deceleration * car.rated_mass / car.mass
    climb = GRAVITY * jnp.cos(motion.pose_w[:, 2]) * gear
    grades = sim.grade_x, sim.grade_x + sim.ramp[2]
    wanted = speed / sim.ctrl_dt - jnp.minimum(*(climb * grade for grade in grades))
    strength = jnp.clip(wanted / decel, HOLD_PEDAL, 1.0)
    stands = speed < jnp.where(slides, HOLD_SPEED, STANDING)
    return jnp.where(stands, 0.0, -gear * jnp.where(slides, 1.0, strength))


def stopping_way(
    sim: SimConfig,
    car: Vehicle,
    drive: tuple[jax.Array, jax.Array, jax.Array],
    climb: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Way (...) [m] and time (...) [s] of cars that obey for a step and then brake.

    The gap to keep is part of the way of a car that moves. `drive` and `climb` are in
    the direction looked at: speed [m/s], negative = stands, pedal in [-1, 1], and speed
    up to which it drives [m/s]; acceleration of the slope [m/s²].
    """
    speed, pedal, limit = drive
    by_load = car.rated_mass / car.mass
    grip = car.tyres.friction * GRAVITY
    brake = jnp.minimum(car.max_deceleration * by_load, grip)
    decel = jnp.maximum(brake - climb, LEAST)
    idle = 0.0 if car.creep is None else car.creep
    push = jnp.maximum(pedal * car.max_acceleration, idle) * by_load + climb
    pull = jnp.where(pedal < 0.0, pedal * brake + climb, push)
    change = pull * sim.ctrl_dt + jnp.maximum(pull, 0.0) * car.drive_lag
    before = jnp.maximum(speed, 0.0)
    after = jnp.clip(before + change, 0.0, jnp.maximum(before, limit))
    last = after % (decel * sim.ctrl_dt)  # lost evenly over the last step, see `stop`
    way = (before + after) / 2 * sim.ctrl_dt + (after**2 - last**2) / (2 * decel)
    way = way + last / 2 * sim.ctrl_dt + after * sim.pedal_delay
    gap = jnp.where(after > 0.0, sim.emergency_brake, 0.0)
    return way + gap, sim.ctrl_dt + sim.pedal_delay + after / decel


def sweep(
    sim: SimConfig, car: Vehicle, motion: Motion, controls: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Poses (n, k, 3) of cars' centres and times (n, k) [s] until they stand.

    On arcs between the present steering angle and that of the next step, when it is
    held. Wheels that lock do not steer: their cars slide straight on from the velocity
    of their centre, drift down the slope, and turn on or not.
    """
    steer, pedal = controls[:, 0], controls[:, 1]
    slides = sliding(car)
    side = motion.velocity_b[:, 1] + motion.yaw_rate * car.centre_offset
    gear = jnp.where(motion.speed < 0.0, -1.0, 1.0)
    speed = gear * jnp.hypot(motion.speed, jnp.where(slides, side, 0.0))
    slip = jnp.arctan2(gear * side, jnp.maximum(jnp.abs(motion.speed), SLIPPING))
    grade = max(sim.grade_x, sim.grade_x + sim.ramp[2], key=abs)
    down = -GRAVITY * grade * jnp.cos(motion.pose_w[:, 2] + slip)
    # The way of a car that slides bends downhill: half of the steepest.
    most = GRAVITY * sim.steepest
    climb = [jnp.where(slides, (most + x) / 2, most) for x in (down, -down)]
    ahead = stopping_way(sim, car, (speed, pedal, car.max_speed), climb[0])
    behind = stopping_way(sim, car, (-speed, -pedal, car.max_reverse_speed), climb[1])
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
    wider = jnp.where(slides, 0.0, WIDER)
    low, high = jnp.minimum(low, wider * low), jnp.maximum(high, wider * high)
    part = jnp.linspace(0.0, 1.0, ARCS)
    curvature = (low[:, None] + (high - low)[:, None] * part)[..., None]
    slides, slip, way, offset, speed, duration = (
        x[:, None, None]
        for x in (slides, slip, way, car.centre_offset, speed, duration)
    )
    along = way * SHARE
    half_turn = along * curvature / 2
    # The centre is on a circle about a point beside the rear axle. The chord of its
    # arc, to the third order.
    slant = offset * curvature
    chord = along * jnp.sqrt(1.0 + slant * slant) * (1.0 - half_turn * half_turn / 6.0)
    # A car that slides has followed its steering for a step.
    straight = slip + curvature * speed * sim.ctrl_dt
    bend = jnp.where(slides, straight, jnp.arctan(slant) + half_turn)
    chord = jnp.where(slides, along, chord)
    x, y, yaw = (motion.pose_w[:, k, None, None] for k in range(3))
    cos, sin = jnp.cos(yaw + bend), jnp.sin(yaw + bend)
    pull = jnp.where(slides, GRAVITY * grade, 0.0)
    drift = pull * sin * duration * duration * DRIFT
    x, y = x + chord * cos - drift * sin, y + chord * sin + drift * cos
    pose = jnp.stack([x, y, yaw + 2.0 * half_turn], axis=-1)
    time = jnp.broadcast_to(duration * SHARE, half_turn.shape)
    count = way.shape[0]
    return pose.reshape(count, -1, 3), time.reshape(count, -1)


def endangered(
    motion: Motion, swept: tuple[jax.Array, jax.Array], aside: jax.Array, group: Group
) -> jax.Array:
    """Whether cars (n,) bool would come within gaps `aside` (n,) [m] of one of a group.

    At the poses and times swept, where they are and where their velocity leads.
    """
    pose, time = swept
    here, size = motion.pose_w[:, None, None], motion.size[:, None, None]

    def near(others: Group) -> jax.Array:
        gap = others.distance(pose[:, :, None], size)
        nearer = gap < NEARER * others.distance(here, size)
        return (gap < aside[:, None, None]) & nearer

    found = near(group)
    if group.velocity_w is not None:
        way = group.velocity_w * time[..., None, None]
        way = jnp.pad(way, ((0, 0),) * 3 + ((0, group.pose_w.shape[-1] - 2),))
        found = found | near(dataclasses.replace(group, pose_w=group.pose_w + way))
    counts = group.counts(motion.size.shape[0])[:, None]
    return (found & counts).any(axis=(1, 2))

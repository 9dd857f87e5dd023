"""A step of drivers: how fast they go, and how they steer.

Each is a kinematic bicycle of the back end `bicycle` (`physics.bicycle.advance`) with
the steering of its car (`vehicle.drive.steer_towards`) and its limits of acceleration
and braking. Pure pursuit (Coulter 1992) steers it along its path. Behind another it
accelerates by the Intelligent Driver Model: Treiber, Hennecke and Helbing 2000,
"Congested traffic states in empirical observations and microscopic simulations",
Physical Review E 62, 1805, equations 2 and 3 with delta = 4:

    a (1 - (v / v0)^4 - (s* / s)^2),  s* = s0 + v T + v dv / (2 sqrt(a b)).
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.geometry import boxes_overlap, move_forward, rotate
from carpark_mj.geometry.obstacles import touches
from carpark_mj.movers.lookout import HARD, look
from carpark_mj.movers.traffic import (
    AWAY,
    BACK_OUT,
    DRIVE,
    PARK,
    SIZE,
    STAY,
    Traffic,
    choose,
    track_path,
    turn_back,
)
from carpark_mj.physics.bicycle import advance, slip_angle
from carpark_mj.types import NO_BAY, State
from carpark_mj.vehicle import make_vehicle
from carpark_mj.vehicle.drive import steer_towards
from carpark_mj.vehicle.presets import CITY

JAM_GAP = 1.0  # m, s0; 2 m on motorways, shorter at walking pace [est]
BRAKING = 1.67  # m/s², b, table I
NO_GAP = 0.05  # m, below which a gap counts as this
ROUNDS = 4  # substeps
AHEAD = 1.2  # m to the point that is aimed at, and in 0.3 s
TURNING, BACKING = 1.5, 0.8  # m/s in arcs, in reverse
EASY = 1.0  # m/s², braking before arcs and ends of paths
WHEELS = 0.25  # rad, how far the wheels may still have to turn at walking pace
CLOSE = 0.1  # m, from the end of a path
LEAVES_AFTER = 2.0  # s at the end of a lane
GIVES_UP = 12.0  # s of standing, after which a driver changes its mind
BEHIND = 0.5  # m before an arc, to which a driver goes back who is stuck in it
DECIDED = 0.3  # m behind an arc, where a driver is on the next track


def idm_acceleration(
    speed: jax.Array,
    wanted: jax.Array,
    gap: jax.Array,
    leader_speed: jax.Array,
    headway: jax.Array,
    accel: jax.Array,
) -> jax.Array:
    """Accelerations (...) [m/s²] of the Intelligent Driver Model.

    Args:
        speed: v [m/s].
        wanted: v0 [m/s].
        gap: s to who is ahead [m].
        leader_speed: of who is ahead [m/s].
        headway: T [s].
        accel: a [m/s²].
    """
    closing = speed * (speed - leader_speed) / (2.0 * jnp.sqrt(accel * BRAKING))
    desired = JAM_GAP + jnp.maximum(speed * headway + closing, 0.0)
    held = (desired / jnp.maximum(gap, NO_GAP)) ** 2
    return accel * (1.0 - (speed / wanted) ** 4 - held)


def drive(
    key: jax.Array,
    traffic: Traffic,
    lot: State,
    speeds: tuple[float, float],
    headways: tuple[float, float],
    stays: tuple[float, float],
    dt: float,
) -> Traffic:
    """The drivers after a control step; `lot` is the state before it."""
    pushes = traffic.aggressiveness
    wanted = speeds[0] + (speeds[1] - speeds[0]) * pushes
    headway = headways[1] - (headways[1] - headways[0]) * pushes
    accel = CITY.max_acceleration * (0.5 + 0.5 * pushes)
    ahead = look(traffic, lot, accel, dt)
    taken = (traffic.bay[:, None] == lot.parked_cars.bay).any(axis=1)
    taken = taken & (traffic.phase == PARK)  # somebody was faster: wait for the bay
    gap = jnp.where(taken, 0.0, ahead.gap)
    target = _aim(traffic)
    limit = _limit(traffic, jnp.abs(target - traffic.steering))
    speed = traffic.speed
    wish = idm_acceleration(speed, wanted, gap, ahead.speed, headway, accel)
    faster = speed + dt * jnp.clip(wish, -HARD, accel)
    faster = jnp.minimum(faster, jnp.maximum(limit, speed - HARD * dt))
    # Whatever the model wishes, the car can stop before who is ahead.
    usable = jnp.maximum(gap - CLOSE - speed * dt / 2, 0.0)
    safe = HARD * (jnp.sqrt(dt * dt / 4 + 2.0 * usable / HARD) - dt / 2)
    faster = jnp.minimum(faster, safe)
    faster = jnp.maximum(faster, jnp.maximum(speed - CITY.max_deceleration * dt, 0.0))
    moves = traffic.present & (traffic.phase != STAY)
    faster = jnp.where(moves, faster, 0.0)
    traffic = _halt(traffic, _roll(traffic, target, faster, dt), lot)
    stands = (traffic.speed < 0.2) | (traffic.phase == STAY) | (traffic.phase == AWAY)
    clock = jnp.where(stands, traffic.clock + dt, 0.0)
    return _go_on(key, dataclasses.replace(traffic, clock=clock), stays)


def _aim(traffic: Traffic) -> jax.Array:
    """Steering angles (n,) [rad] of pure pursuit."""
    path, reach = traffic.path, AHEAD + 0.3 * traffic.speed
    point = path.at((traffic.way + reach)[:, None])[:, 0, :2]
    local = rotate(point - traffic.pose[:, :2], -traffic.pose[:, 2])
    square = jnp.maximum(jnp.sum(local * local, axis=-1), 0.25)
    angle = jnp.arctan(CITY.wheelbase * 2.0 * local[:, 1] / square)
    return jnp.clip(angle, -CITY.max_steering, CITY.max_steering)


def _limit(traffic: Traffic, turn: jax.Array) -> jax.Array:
    """Highest speeds (n,) [m/s], with `turn` [rad] still to be steered."""
    path, way = traffic.path, traffic.way
    to_arc = jnp.maximum(path.straight - 0.5 - way, 0.0)
    to_arc = jnp.where((path.bend == 0.0) | (way > path.arc_end), jnp.inf, to_arc)
    limit = jnp.sqrt(TURNING**2 + 2.0 * EASY * to_arc)
    to_end = jnp.maximum(path.total - way - CLOSE / 2, 0.0)
    limit = jnp.minimum(limit, jnp.sqrt(2.0 * EASY * to_end))
    limit = jnp.where(path.gear < 0.0, jnp.minimum(limit, BACKING), limit)
    slow = jnp.maximum(TURNING * (1.0 - turn / WHEELS), 0.0)
    return jnp.where(turn > WHEELS / 3, jnp.minimum(limit, slow), limit)


def _roll(traffic: Traffic, target: jax.Array, faster: jax.Array, dt: float) -> Traffic:
    """Drivers after a control step in which speeds change evenly."""
    car, gear = make_vehicle(CITY), traffic.path.gear
    to_middle = CITY.wheelbase / 2
    middle, steering = move_forward(traffic.pose, to_middle), traffic.steering
    way, step = traffic.way, dt / ROUNDS
    rolls = faster + traffic.speed > 0.0
    for number in range(ROUNDS):
        share = (number + 0.5) / ROUNDS
        rear = traffic.speed + share * (faster - traffic.speed)
        steering = steer_towards(car, steering, target / CITY.max_steering, step)
        speed = gear * rear / jnp.cos(slip_angle(steering))
        middle = advance(middle, speed, steering, car.wheelbase, step)
        way = way + rear * step
    pose = jnp.where(rolls[:, None], move_forward(middle, -to_middle), traffic.pose)
    path, along = traffic.path, traffic.path.along(pose[:, :2])
    way = jnp.where((way < path.straight) & (along < path.straight), along, way)
    return dataclasses.replace(
        traffic, pose=pose, speed=faster, steering=steering, way=way
    )


def _halt(before: Traffic, after: Traffic, lot: State) -> Traffic:
    """Drivers after a step; who would touch a mover stays, also who does not look."""
    pose, others = after.centre, ~jnp.eye(after.way.shape[0], dtype=bool)
    hits = touches(pose, SIZE, lot.movers.groups)
    for there in (before.centre, pose):
        meets = boxes_overlap(pose[:, None], SIZE, there, SIZE)
        hits = hits | (meets & others & before.present).any(axis=1)
    return dataclasses.replace(
        after,
        pose=jnp.where(hits[:, None], before.pose, after.pose),
        way=jnp.where(hits, before.way, after.way),
        speed=jnp.where(hits, 0.0, after.speed),
    )


def _go_on(key: jax.Array, traffic: Traffic, stays: tuple[float, float]) -> Traffic:
    """Drivers who have come to the end of a path, or of the arc to the next track."""
    path, phase, bay = traffic.path, traffic.phase, traffic.bay
    at_end = (path.total - traffic.way < 2.0 * CLOSE) & (traffic.speed < 0.1)
    turned = (phase == DRIVE) & (path.bend != 0.0)
    turned = turned & (traffic.way > path.arc_end + DECIDED)
    backed = (phase == BACK_OUT) & at_end
    parked = (phase == PARK) & at_end
    leaves = (phase == DRIVE) & at_end & (path.bend == 0.0)
    leaves = leaves & (traffic.clock > LEAVES_AFTER)
    # Who cannot turn off goes straight on, who is stuck in an arc goes back.
    stuck = (traffic.clock > GIVES_UP) & ~at_end
    fresh = (path.bend != 0.0) & (path.straight > 1.0)  # of a path not gone back yet
    begun = traffic.way >= path.straight
    drops = stuck & fresh & ~begun & ((phase == DRIVE) | (phase == PARK))
    to_track = stuck & fresh & begun & (phase == PARK)
    to_bay = stuck & (phase == BACK_OUT)
    back = turn_back(path)
    shorter = jnp.where(to_track, path.straight - BEHIND, 0.0)
    back = dataclasses.replace(back, total=back.total - shorter)
    way = jnp.where(to_bay | to_track, path.total - traffic.way, traffic.way)
    path = choose(to_bay | to_track, back, path)
    changes = drops | to_bay | to_track
    joins = turned | backed | drops
    track = jnp.where(turned | backed, traffic.next_track, traffic.track)
    path = choose(joins, track_path(traffic.tracks, track), path)
    stay = jax.random.uniform(key, phase.shape, minval=stays[0], maxval=stays[1])
    phase = jnp.where(backed | drops, DRIVE, jnp.where(parked, STAY, phase))
    phase = jnp.where(to_bay, PARK, jnp.where(to_track, BACK_OUT, phase))
    phase = jnp.where(leaves, AWAY, phase)
    return dataclasses.replace(
        traffic,
        path=path,
        way=jnp.where(joins, path.along(traffic.pose[:, :2]), way),
        phase=phase,
        track=track,
        next_track=jnp.where(to_track, track, traffic.next_track),
        bay=jnp.where(backed | drops, NO_BAY, bay),
        clock=jnp.where(parked | leaves | changes, 0.0, traffic.clock),
        stay=jnp.where(parked, stay, traffic.stay),
    )

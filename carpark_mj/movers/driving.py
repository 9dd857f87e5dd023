"""A step of drivers: what they see ahead, how fast they go, and how they steer.

Paths are cut into sections; a section is the box that the car sweeps there. A driver
reacts to the nearest section that is occupied now or lies within another car's stopping
distance, or farther ahead of a car with priority. The car that yields allows for a
control step of acceleration of the other. So stopping distances never overlap, and
attentive drivers never collide.

Behind another it accelerates by the Intelligent Driver Model, equations 2 and 3 of
Treiber, Hennecke and Helbing 2000 with delta = 4 (see `carpark_mj.movers.drivers`):

    a (1 - (v / v0)^4 - (s* / s)^2),  s* = s0 + v T + v dv / (2 sqrt(a b)).
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.geometry import boxes_overlap, move_forward, norm, rotate, to_local
from carpark_mj.geometry.obstacles import ObstacleKind, touches
from carpark_mj.movers.traffic import (
    AWAY,
    BACK_OUT,
    DRIVE,
    OFFSET,
    PARK,
    SIZE,
    STAY,
    Traffic,
    track_path,
    turn_back,
)
from carpark_mj.physics.base import where_cars
from carpark_mj.physics.bicycle import advance, slip_angle
from carpark_mj.types import NO_BAY, State
from carpark_mj.vehicle import make_vehicle
from carpark_mj.vehicle.drive import steer_towards
from carpark_mj.vehicle.presets import CITY

PATIENCE = 6.0  # s at rest, after which the longest wait goes first
EDGES = (0.0, 0.4, 1.0, 2.0, 3.0, 4.5, 6.0, 8.0, 10.5)  # m, of the sections
ASIDE, ALONG = 0.3, 0.15  # m of room about a car
HARD = 3.0  # m/s², with which drivers reckon to stop; cars brake with 4
YIELDS_FOR = 2.5  # s before another driver that goes first
OUT = 3.0  # m of a way out of a bay with limited sight
SIGHT = 1.5  # m to either side for each metre behind a bay
SOON = 1.0  # s, where people will be
PERSON = 0.3  # m of room about a person
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
BEHIND = 0.5  # m before an arc, to which a driver stuck in it goes back
DECIDED = 0.3  # m behind an arc, where a driver is on the next track


def goes_first(traffic: Traffic) -> jax.Array:
    """(n, n) bool, whether the second of a pair goes before the first; one of both.

    Right of way is that of `carpark_mj.movers.drivers`; ties go to the more aggressive.
    """
    pose, phase = traffic.centre, traffic.phase
    local = to_local(pose[:, None], pose)
    y, turned = local[..., 1], local[..., 2]
    crosses = jnp.abs(jnp.sin(turned)) > 0.5
    from_right = crosses & (y < 0.0) & (y.T > 0.0)
    left = traffic.path.bend > 0.3
    oncoming = (jnp.cos(turned) < -0.7) & left[:, None] & ~left
    rank = jnp.where(phase == PARK, 1, jnp.where(phase == BACK_OUT, 0, 2))
    rank = jnp.where(phase == STAY, -1, rank)
    wait = jnp.where(traffic.clock > PATIENCE, traffic.clock, 0.0)
    order = jnp.arange(rank.shape[0])
    pushes = traffic.aggressiveness
    tie = (pushes == pushes[:, None]) & (order < order[:, None])
    decisive = (pushes > pushes[:, None]) | tie

    def more(value: jax.Array, otherwise: jax.Array) -> jax.Array:
        return jnp.where(value == value[:, None], otherwise, value > value[:, None])

    rule = jnp.where(oncoming | oncoming.T, oncoming, decisive)
    rule = jnp.where(from_right | from_right.T, from_right, rule)
    return more(wait, more(rank, rule))


_Ahead = tuple[jax.Array, jax.Array]


def look(traffic: Traffic, lot: State, accel: jax.Array, dt: float) -> _Ahead:
    """Free ways (n,) [m] of drivers and the speeds (n,) [m/s] of the leaders."""
    n, gear = traffic.way.shape[0], traffic.path.gear
    edges = jnp.array(EDGES)
    start, length = edges[:-1], jnp.diff(edges)
    way = traffic.way[:, None] + start + length / 2
    way = jnp.minimum(way, traffic.path.total[:, None])
    sections = move_forward(traffic.path.at(way), OFFSET)
    boxes = jnp.concatenate([traffic.centre[:, None], sections], axis=1)
    longer = jnp.concatenate([jnp.zeros(1), length])
    half = SIZE / 2 + jnp.stack([longer / 2, jnp.zeros_like(longer)], axis=-1)
    room = half + jnp.array([ALONG, ASIDE])

    count = boxes.shape[1]
    pose, other_half, other_velocity, seen = _others(traffic, lot)
    halves = jnp.broadcast_to(half, (n, count, 2)).reshape(-1, 2)
    there = [boxes.reshape(-1, 3), pose], [halves, other_half]
    meets, gap = _meet(boxes, room, gear, *map(jnp.concatenate, there))
    gap = gap + jnp.concatenate([jnp.zeros(1), start])[:, None]
    (meets, meets_others), (gap, gap_others) = (
        jnp.split(x, [n * count], axis=-1) for x in (meets, gap)
    )
    meets = meets.reshape(n, count, n, count)
    limit = _limits(traffic, meets, accel, dt)
    begins = jnp.concatenate([jnp.full(1, -1.0), start])
    counts = (begins < limit[..., None]) & ~jnp.eye(n, dtype=bool)[..., None]
    counts = counts & traffic.present[:, None]
    meets = meets.reshape(n, count, -1) & counts.reshape(n, 1, -1)
    velocity = jnp.repeat(traffic.velocity, count, axis=0).reshape(n * count, 2)
    # The own box is for the right of way only.
    found = _first(boxes, gear, meets[:, 1:], gap[:, 1:], velocity)
    meets = (meets_others & seen[:, None])[:, 1:]
    others = _first(boxes, gear, meets, gap_others[:, 1:], other_velocity)
    return where_cars(others[0] < found[0], others, found)


def _first(
    boxes: jax.Array,
    gear: jax.Array,
    meets: jax.Array,
    gap: jax.Array,
    velocity: jax.Array,
) -> _Ahead:
    """The nearest of rows (k,) that sections (n, m, k) meet, and its speed."""
    gap = jnp.where(meets, gap, jnp.inf)
    nearest = gap.min(axis=(1, 2))
    yaw = boxes[:, 1:, 2:]
    along = velocity[:, 0] * jnp.cos(yaw) + velocity[:, 1] * jnp.sin(yaw)
    along = jnp.maximum(along * gear[:, None, None], 0.0)
    first = gap <= nearest[:, None, None]
    speed = jnp.where(first & meets, along, jnp.inf).min(axis=(1, 2))
    return nearest, jnp.where(jnp.isfinite(nearest), speed, 0.0)


def _meet(
    boxes: jax.Array, room: jax.Array, gear: jax.Array, pose: jax.Array, half: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Whether boxes (n, m, 3) meet others (k, 3), and the way (n, m, k) until then."""
    x, y, other = jnp.unstack(pose, axis=-1)
    own_x, own_y, own = jnp.unstack(boxes[..., None, :], axis=-1)
    x, y, cos, sin = x - own_x, y - own_y, jnp.cos(own), jnp.sin(own)
    far, near = jnp.cos(other), jnp.sin(other)
    same, across = jnp.abs(cos * far + sin * near), jnp.abs(cos * near - sin * far)
    ahead = cos * x + sin * y
    half_x, half_y = room[:, :1], room[:, 1:]
    long, wide = jnp.unstack(half, axis=-1)
    reach = same * long + across * wide
    meets = jnp.abs(ahead) < half_x + reach
    aside = jnp.abs(cos * y - sin * x)
    meets = meets & (aside < half_y + across * long + same * wide)
    ahead_of = jnp.abs(far * x + near * y)
    meets = meets & (ahead_of < long + same * half_x + across * half_y)
    aside_of = jnp.abs(far * y - near * x)
    meets = meets & (aside_of < wide + across * half_x + same * half_y)
    car = SIZE[0] / 2 + ALONG
    section = half_x - car  # half of its length
    free = gear[:, None, None] * ahead + section - car - reach
    return meets, jnp.clip(free, 0.0, 2.0 * section)


def _limits(
    traffic: Traffic, meets: jax.Array, accel: jax.Array, dt: float
) -> jax.Array:
    """(n, n) how much of the second's way the first leaves to it [m]."""
    speed, parked = traffic.speed, traffic.phase == STAY
    stop = speed**2 / (2.0 * HARD)
    faster = speed + accel * dt
    soon = (speed + faster) / 2 * dt + faster**2 / (2.0 * HARD)
    soon = jnp.where(parked, 0.0, soon)
    wish = jnp.where(traffic.phase == DRIVE, speed * YIELDS_FOR, 0.0)
    # A car that stands in the other's way is further in, and goes on.
    wanted = jnp.array([-1.0, *EDGES[:-1]]) < wish[:, None]
    inside = (meets[:, 0] & wanted).any(axis=-1)
    wish = jnp.where(inside | _hidden(traffic, traffic.centre), 0.0, wish)
    limit = jnp.where(goes_first(traffic), jnp.maximum(soon, wish), stop)
    # Inattentive drivers see cars ahead, nothing behind.
    blind = jnp.where(traffic.path.gear > 0.0, 0.0, -2.0)
    return jnp.where(traffic.attentive[:, None], limit, blind[:, None])


def _hidden(traffic: Traffic, pose: jax.Array) -> jax.Array:
    """(n, k) bool, whether neighbours hide poses (k, 3) from a car backing out."""
    within = (traffic.phase == BACK_OUT) & (traffic.way < OUT)
    own = traffic.centre
    x, y = pose[:, 0] - own[:, :1], pose[:, 1] - own[:, 1:2]
    cos, sin = jnp.cos(own[:, 2:]), jnp.sin(own[:, 2:])
    behind = -(cos * x + sin * y) - SIZE[0] / 2
    aside = jnp.abs(cos * y - sin * x) - SIZE[1]
    return within[:, None] & (aside > SIGHT * jnp.maximum(behind, 0.0))


def _others(traffic: Traffic, lot: State) -> tuple[jax.Array, ...]:
    """Poses, half sizes, velocities of boxes (k, ...) and (n, k) which drivers see."""
    motion = lot.motion
    yaw, along = motion.pose_w[:, 2], motion.speed
    stop = along * jnp.abs(along) / (2.0 * HARD)
    half = motion.size / 2
    half = half + jnp.stack([jnp.abs(stop) / 2, jnp.zeros_like(stop)], axis=-1)
    heading = jnp.stack([jnp.cos(yaw), jnp.sin(yaw)], axis=-1)
    pose = move_forward(motion.pose_w, stop / 2)
    rows = [(pose, half, along[:, None] * heading, jnp.ones(yaw.shape, bool))]
    for group in lot.movers.groups:
        here, size, velocity, there = group.as_boxes
        is_car = group.kind == ObstacleKind.DRIVER
        half = size / 2 + (0.0 if is_car else PERSON)
        for later in (0.0,) if is_car else (0.0, SOON):
            xy = here[:, :2] + later * velocity
            pose = jnp.concatenate([xy, here[:, 2:]], axis=-1)
            rows.append((pose, half, velocity, there))
    pose, half, velocity, there = (
        jnp.concatenate(column) for column in zip(*rows, strict=True)
    )
    blind = (traffic.path.gear < 0.0) & ~traffic.attentive
    seen = there & ~_hidden(traffic, pose) & ~blind[:, None]
    return pose, half, velocity, seen


def is_clear(traffic: Traffic, lot: State, xy: jax.Array, reach: float) -> jax.Array:
    """() bool, whether nobody is within a distance [m] of a point (2,)."""
    clear = ~((norm(traffic.centre[:, :2] - xy) < reach) & traffic.present).any()
    clear = clear & ~(norm(lot.motion.xy - xy) < reach).any()
    for group in lot.movers.groups:
        near = norm(group.pose_w[:, :2] - xy) < reach
        clear = clear & ~(near if group.mask is None else near & group.mask).any()
    return clear


def idm_acceleration(
    speed: jax.Array,
    wanted: jax.Array,
    gap: jax.Array,
    leader_speed: jax.Array,
    headway: jax.Array,
    accel: jax.Array,
) -> jax.Array:
    """Accelerations (...) [m/s²] of the Intelligent Driver Model.

    With v [m/s], v0 [m/s], s [m] to the leader and its speed [m/s], T [s] and a [m/s²].
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
    gap, leader_speed = look(traffic, lot, accel, dt)
    taken = (traffic.bay[:, None] == lot.parked_cars.bay).any(axis=1)
    taken = taken & (traffic.phase == PARK)  # another was faster: wait for the bay
    gap = jnp.where(taken, 0.0, gap)
    target = _aim(traffic)
    limit = _limit(traffic, jnp.abs(target - traffic.steering))
    speed = traffic.speed
    wish = idm_acceleration(speed, wanted, gap, leader_speed, headway, accel)
    faster = speed + dt * jnp.clip(wish, -HARD, accel)
    faster = jnp.minimum(faster, jnp.maximum(limit, speed - HARD * dt))
    # Whatever the model wishes, the car can stop before the leader.
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
    """Drivers after a step; each stays that would touch a mover."""
    pose, others = after.centre, ~jnp.eye(after.way.shape[0], dtype=bool)
    hits = touches(pose, SIZE, lot.movers.groups)
    there = jnp.concatenate([before.centre, pose])
    meets = boxes_overlap(pose[:, None], SIZE, there, SIZE)
    hits = hits | (meets & jnp.tile(others & before.present, 2)).any(axis=1)
    return dataclasses.replace(
        after,
        pose=jnp.where(hits[:, None], before.pose, after.pose),
        way=jnp.where(hits, before.way, after.way),
        speed=jnp.where(hits, 0.0, after.speed),
    )


def _go_on(key: jax.Array, traffic: Traffic, stays: tuple[float, float]) -> Traffic:
    """Drivers at the end of a path, or of the arc to the next track."""
    path, phase, bay = traffic.path, traffic.phase, traffic.bay
    at_end = (path.total - traffic.way < 2.0 * CLOSE) & (traffic.speed < 0.1)
    turned = (phase == DRIVE) & (path.bend != 0.0)
    turned = turned & (traffic.way > path.arc_end + DECIDED)
    backed = (phase == BACK_OUT) & at_end
    parked = (phase == PARK) & at_end
    leaves = (phase == DRIVE) & at_end & (path.bend == 0.0)
    leaves = leaves & (traffic.clock > LEAVES_AFTER)
    # A driver that cannot turn off goes straight on; one stuck in an arc goes back.
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
    path = where_cars(to_bay | to_track, back, path)
    changes = drops | to_bay | to_track
    joins = turned | backed | drops
    track = jnp.where(turned | backed, traffic.next_track, traffic.track)
    path = where_cars(joins, track_path(traffic.tracks, track), path)
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

"""A step of pedestrians: where they head for, and how they move.

A walk leads out of the gap between two cars, straight to another place that can be
seen, and perhaps into the gap there. In gaps and when they run, people go straight;
elsewhere by the social force model. Nobody steps into anybody or anything.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp

from carpark_mj.config.obstacles import ObstacleKind
from carpark_mj.geometry import norm
from carpark_mj.movers import social_force
from carpark_mj.movers.bodies import (
    go_round,
    is_clear,
    meets,
    room_among,
    room_to,
)
from carpark_mj.movers.outlines import (
    AWAY,
    columns,
    group_outlines,
    meet,
    offsets,
    outlines,
)
from carpark_mj.movers.people import People
from carpark_mj.movers.stopping import (
    Cars,
    Zones,
    cars_of,
    keep_off,
    stopping_zones,
)
from carpark_mj.types import State

REST, OUT, ACROSS, IN = range(4)  # phases of a walk
ARRIVED = 0.4  # m
LEG = 60.0  # s, after which somebody who cannot get there heads elsewhere
STAY, LONG_STAY = 5.0, 40.0  # s, mean rest at a place, of those who mostly stand
GOES_IN = 0.3  # probability that an adult goes between the cars at the end of a walk
RUN = 2.5  # m/s, of children who run
HEADWAY = 3.0  # s, who gives way leaves a car as much
PATIENCE = 2.0, 5.0  # s without headway until who gives way, or not, turns elsewhere
SLOW = 0.2  # m/s, what is no headway
WAITS = 0.1  # m/s, cars that are slower wait
CLOSE = 1.5  # m from a car that waits: nobody rests there
ASIDE = 0.5  # m, how far from a car's way those who give way step aside
NEAR = 4  # boxes whose forces act on a person
ROUNDS = 8  # steps after which near boxes are looked up again
CANDIDATES = 4  # targets that are looked at
TAKEN = 1e3  # m, added to the distance of places that are taken


def walk(key: jax.Array, people: People, lot: State, dt: float) -> People:
    """The people after a control step; `lot` is the state before it."""
    # All numbers of a step at once: every call for some would cost as much.
    chance = jax.random.uniform(key, (people.speed.shape[0] + CANDIDATES + 1,))
    cars, people = cars_of(lot, dt), _find_near(people, lot)
    things = group_outlines(
        [group for group in lot.movers.groups if group.kind != ObstacleKind.DRIVER]
    )
    people = _set_out(chance[: CANDIDATES + 1], people, cars, lot)
    waypoint = _waypoint(people)
    to_go = waypoint - people.xy
    distance = norm(to_go)
    rests = people.phase == REST
    speed = jnp.where(people.child & ~rests, RUN, people.speed)
    heading = to_go / jnp.maximum(distance, 1e-3)[:, None]
    # Nobody overshoots, and who rests stays.
    pace = jnp.minimum(speed, distance / dt)
    pace = jnp.where(rests & (distance < ARRIVED), 0.0, pace)
    stop = stopping_zones(lot, dt)
    gives_way = people.attentive[:, None] * HEADWAY
    enter = stopping_zones(lot, dt, gives_way)
    wanted = pace[:, None] * heading + _step_aside(people, enter, stop)
    straight = people.straight | (people.child & ~rests)
    straight = straight | (people.phase != ACROSS)
    borders = [people.near, things[:, None], _boxes(cars)[:, None]]
    aim = social_force.Aim(wanted, heading, speed, straight, people.radius)
    apart = functools.partial(_apart, people)
    end, velocity = social_force.walk(
        people.xy, people.velocity, aim, apart, borders, dt
    )
    wish = end - people.xy
    everything = jnp.concatenate([_parked(lot), people.places.walls, things], axis=1)
    others = room_among(apart(people.xy), people.radius)
    near = [room_to(people.xy, people.radius, boxes) for boxes in borders[:2]]
    move = go_round([others, *near], wish)
    kept = keep_off(people.xy, move, waypoint, people.radius, enter, stop)
    # Nobody is pushed out of the lot.
    stays = (jnp.abs(people.xy + kept) < lot.layout.extent).all(axis=-1)
    stays = stays & people.present & is_clear(others, kept)
    stays = stays & ~meets(people.xy, kept, people.radius, everything)
    move = jnp.where(stays[:, None], kept, 0.0)
    # What is cut of a move is lost speed.
    velocity = velocity + (move - wish) / dt
    velocity = jnp.where((norm(move) > 0.0)[:, None], velocity, 0.0)
    xy = people.xy + move
    left = norm(waypoint - xy)
    halted = ~rests | _by_waiting(people.xy, cars)
    halted = halted & (distance - left < SLOW * dt)
    people = dataclasses.replace(
        people,
        xy=xy,
        velocity=velocity,
        clock=people.clock + dt,
        halted=jnp.maximum(people.halted + jnp.where(halted, dt, -dt), 0.0),
    )
    return _go_on(chance[CANDIDATES + 1 :], people, left < ARRIVED)


def _waypoint(people: People) -> jax.Array:
    """(n, 2) where people head for [m]; who walks with another does not go in."""
    places, alone = people.places, people.leader == jnp.arange(people.leader.shape[0])
    goes_out = people.phase == OUT
    at = jnp.where(goes_out, people.place, people.target)
    within = (people.phase == IN) | ((people.phase == REST) & people.inside)
    edge, inner = places.edge[at], places.inner[at]
    return jnp.where((within & alone)[:, None], inner, edge) + people.offset


def _go_on(chance: jax.Array, people: People, arrived: jax.Array) -> People:
    """People whose next phase begins if they have arrived; groups follow leaders.

    `chance` (n,) are random numbers in [0, 1).
    """
    phase, inside = people.phase, people.inside
    rest = -jnp.log1p(-chance) * jnp.where(people.stands, LONG_STAY, STAY)
    next_phase = jnp.where(phase == OUT, ACROSS, REST)
    next_phase = jnp.where((phase == ACROSS) & inside, IN, next_phase)
    with_next = jnp.roll(people.leader, -1) == people.leader
    halted = jnp.where(with_next, jnp.roll(people.halted, -1), 0.0)
    halted = jnp.maximum(people.halted, halted)
    gives_up = halted > jnp.where(people.attentive, *PATIENCE)
    late = (people.clock > LEG) | gives_up
    changes = (phase != REST) & (arrived | late)
    # Who comes too late is where the walk ends, for want of a better place.
    phase = jnp.where(changes, jnp.where(late, REST, next_phase), phase)
    inside = inside & ~(changes & late)
    stays = changes & (phase == REST)
    clock = jnp.where(changes, 0.0, people.clock)
    clock = jnp.where(stays, jnp.where(late, 0.0, -rest), clock)
    clock = jnp.where(gives_up, jnp.maximum(clock, 0.0), clock)
    lead = people.leader
    return dataclasses.replace(
        people,
        phase=phase[lead],
        inside=inside[lead],
        clock=clock[lead],
        halted=jnp.where(gives_up[lead], 0.0, people.halted),
    )


def _set_out(chance: jax.Array, people: People, cars: Cars, lot: State) -> People:
    """People of whom the one that has rested longest sets out, if it is time.

    One in a step: looking for ways is the costliest of all.
    """
    places, count = people.places, people.leader.shape[0]
    due = (people.phase == REST) & (people.clock >= 0.0) & people.present
    due = due & (people.leader == jnp.arange(count))
    who = jnp.argmax(jnp.where(due, people.clock, -1.0))
    here, inside = people.target[who], people.inside[who]
    # Who is in a bay, or has a car before the gap, looks out between what stands there.
    boxes = _boxes(cars)
    blocks = jnp.concatenate([places.blocks, boxes], axis=1)
    start = jnp.where(inside, places.edge[here], people.xy[who])
    shut = meet(start[None], start[None], blocks)[0]
    inside = inside & ~shut
    start = jnp.where(shut, people.xy[who], start)
    most = places.mask.shape[0]
    found = jnp.minimum((chance[1:] * most).astype(jnp.int32), most - 1)
    ends = places.edge[found]
    starts = jnp.broadcast_to(start, ends.shape)
    bodies = jnp.concatenate([_parked(lot), places.walls, boxes], axis=1)
    hidden = jnp.where(shut, meet(starts, ends, bodies), meet(starts, ends, blocks))
    good = places.mask[found] & (found != here) & ~hidden & ~_by_waiting(ends, cars)
    # The nearest of them, so that most walks are short; a place that is somebody's only
    # where no other is left, or in a full lot whoever is in the way would stay there.
    taken = ((people.target == found[:, None]) & people.present).any(axis=1)
    distance = norm(ends - start) + jnp.where(taken, TAKEN, 0.0)
    target = found[jnp.argmin(jnp.where(good, distance, jnp.inf))]
    goes = due[who] & good.any()
    goes_in = people.child[who] | (chance[0] < GOES_IN)
    inner = places.inner[target]
    goes_in = goes_in & _has_room(inner, people.radius[who], lot)
    goes_in = goes_in & (target < lot.layout.bay_mask.shape[0])

    own = people.leader == who

    def change(old: jax.Array, new: jax.Array) -> jax.Array:
        return jnp.where(own & goes, new, old)

    return dataclasses.replace(
        people,
        place=change(people.place, here),
        target=change(people.target, target),
        phase=change(people.phase, jnp.where(inside, OUT, ACROSS)),
        inside=change(people.inside, goes_in),
        # Who finds no way lets the others look first.
        clock=jnp.where(own & due[who], 0.0, people.clock),
    )


def _has_room(xy: jax.Array, radius: jax.Array, lot: State) -> jax.Array:
    """() bool, whether no parked car stands where a disc would."""
    x, y = offsets(xy, _parked(lot))
    return ~(x * x + y * y < radius**2).any()


def _parked(lot: State) -> jax.Array:
    cars = lot.parked_cars
    return outlines(cars.pose_w, cars.size, cars.present)


def _find_near(people: People, lot: State) -> People:
    """People of whom every eighth looks up the boxes that are near."""
    boxes = jnp.concatenate([_parked(lot), people.places.walls], axis=1)
    n, missing = people.near.shape[1], max(NEAR - boxes.shape[1], 0)
    boxes = jnp.pad(boxes, ((0, 0), (0, missing)), constant_values=AWAY)
    rows = -(-n // ROUNDS)
    who = jnp.minimum(people.turn * rows + jnp.arange(rows), n - 1)
    x, y = offsets(people.xy[who][:, None], boxes[:, None])
    found = boxes[:, jax.lax.top_k(-(x * x + y * y), NEAR)[1]]
    # Not a scatter, which is a loop on a CPU.
    own = jnp.arange(n) // rows == people.turn
    near = jnp.where(own[:, None], found[:, jnp.arange(n) % rows], people.near)
    return dataclasses.replace(people, near=near, turn=(people.turn + 1) % ROUNDS)


def _apart(people: People, xy: jax.Array) -> social_force.Pair:
    """X and y (n, n) [m] from the second people to the first; nobody meets themselves.

    Nor does anybody meet those who are not there.
    """
    gone = jnp.where(people.present, 0.0, AWAY) + AWAY * jnp.eye(xy.shape[0])
    return xy[:, :1] - xy[:, 0] + gone, xy[:, 1:] - xy[:, 1]


def _boxes(cars: Cars) -> jax.Array:
    return outlines(cars.pose, cars.size, jnp.ones(cars.size.shape[0], bool))


def _by_waiting(xy: jax.Array, cars: Cars) -> jax.Array:
    """(n,) bool, whether points are close to a car that waits."""
    x, y = offsets(xy[:, None], _boxes(cars))
    waits = jnp.abs(cars.speed) < WAITS
    return ((x * x + y * y < CLOSE**2) & waits).any(axis=1)


def _step_aside(people: People, enter: Zones, stop: Zones) -> jax.Array:
    """Velocities (n, 2) [m/s] out of the ways of cars, of those who give way."""
    here = enter.local(people.xy)
    on_way = enter.hold(here, people.radius[:, None])
    on_way = on_way & (jnp.abs(here[..., 1]) < stop.half[:, 1] + ASIDE)
    on_way = on_way & people.attentive[:, None]
    side = jnp.where(here[..., 1] < 0.0, -1.0, 1.0) * on_way
    x, y = -(side * enter.sin).sum(axis=1), (side * enter.cos).sum(axis=1)
    return columns(x, y)

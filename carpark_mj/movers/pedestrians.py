"""Pedestrians: the people of a lot, and their steps.

A walk leads out of the gap between two cars, straight to another place that can be
seen, and perhaps into the gap there. In gaps and when they run, people go straight;
elsewhere by the social force model. Nobody steps into anybody or anything.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Annotated, TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Bounds, Range, Ratio
from carpark_mj.geometry import norm
from carpark_mj.geometry.obstacles import Discs, Group, ObstacleKind
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.bodies import (
    AWAY,
    DODGE,
    Aim,
    Pair,
    advance_people,
    columns,
    go_round,
    group_outlines,
    is_clear,
    meet,
    meets,
    offsets,
    outlines,
    room_among,
    room_to,
)
from carpark_mj.movers.people import People, make_places
from carpark_mj.movers.stopping import Cars, Zones, cars_of, keep_off, stopping_zones
from carpark_mj.obstacles import MOVERS, Mover
from carpark_mj.types import State

REST, OUT, ACROSS, IN = range(4)  # phases of a walk
ARRIVED = 0.4  # m
LEG = 60.0  # s, after which a blocked person heads elsewhere
RESTS, LONG_REST = 5.0, 40.0  # s, mean rest at a place; of people that mostly stand
GOES_IN = 0.3  # probability that an adult goes between the cars at the end of a walk
RUN = 2.5  # m/s, of running children
HEADWAY = 3.0  # s, that attentive people leave a car
PATIENCE = 2.0, 5.0  # s blocked until attentive, inattentive people turn
SLOW = 0.2  # m/s, what is no headway
WAITS = 0.1  # m/s, cars that are slower wait
CLOSE = 1.5  # m from a waiting car, within which no one rests
ASIDE = 0.5  # m, from a car's way to where attentive people step aside
NEAR = 4  # boxes whose forces act on a person
ROUNDS = 8  # steps after which near boxes are looked up again
CANDIDATES = 4  # targets that are looked at
TAKEN = 1e3  # m, added to the distance of places that are taken
Number = TypeVar("Number", int, float)
CHILD = 0.25  # m, radius
FIRST_REST = 10.0  # s, longest until a person sets out when a lot begins
START_SPARE = 0.01  # m of room about people when a lot begins
TRIES = 8  # places that are tried beside a leader


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
    # Walks do not overshoot; people at rest stay.
    pace = jnp.minimum(speed, distance / dt)
    pace = jnp.where(rests & (distance < ARRIVED), 0.0, pace)
    stop = stopping_zones(cars, dt)
    gives_way = people.attentive[:, None] * HEADWAY
    enter = stopping_zones(cars, dt, gives_way)
    wanted = pace[:, None] * heading + _step_aside(people, enter, stop)
    straight = people.straight | (people.child & ~rests)
    straight = straight | (people.phase != ACROSS)
    borders = [people.near, things[:, None], _boxes(cars)[:, None]]
    aim = Aim(wanted, heading, speed, straight, people.radius)
    apart = functools.partial(_apart, people)
    end, velocity = advance_people(people.xy, people.velocity, aim, apart, borders, dt)
    wish = end - people.xy
    everything = jnp.concatenate([_parked(lot), people.places.walls, things], axis=1)
    others = room_among(apart(people.xy), people.radius)
    near = [room_to(people.xy, people.radius, boxes) for boxes in borders[:2]]
    move = go_round([others, *near], wish, DODGE * dt**2)
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
    """(n, 2) where people head for [m]; followers do not enter bays."""
    places, alone = people.places, people.leader == jnp.arange(people.leader.shape[0])
    at = jnp.where(people.phase == OUT, people.place, people.target)
    within = (people.phase == IN) | ((people.phase == REST) & people.inside)
    edge, inner = places.edge[at], places.inner[at]
    return jnp.where((within & alone)[:, None], inner, edge) + people.offset


def _go_on(chance: jax.Array, people: People, arrived: jax.Array) -> People:
    """People whose next phase begins if they have arrived; groups follow leaders."""
    phase, inside = people.phase, people.inside
    rest = -jnp.log1p(-chance) * jnp.where(people.stands, LONG_REST, RESTS)
    next_phase = jnp.where(phase == OUT, ACROSS, REST)
    next_phase = jnp.where((phase == ACROSS) & inside, IN, next_phase)
    with_next = jnp.roll(people.leader, -1) == people.leader
    halted = jnp.where(with_next, jnp.roll(people.halted, -1), 0.0)
    halted = jnp.maximum(people.halted, halted)
    gives_up = halted > jnp.where(people.attentive, *PATIENCE)
    late = (people.clock > LEG) | gives_up
    changes = (phase != REST) & (arrived | late)
    # A late walk ends where the person is.
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
    """The one that has rested longest sets out, if it is time; looking costs most."""
    places, count = people.places, people.leader.shape[0]
    due = (people.phase == REST) & (people.clock >= 0.0) & people.present
    due = due & (people.leader == jnp.arange(count))
    who = jnp.argmax(jnp.where(due, people.clock, -1.0))
    here, inside = people.target[who], people.inside[who]
    # In a bay, or behind a car before the gap, people look out between the obstacles.
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
    # The nearest of them, so that most walks are short; a taken place only if there is
    # no other, or in a full lot people in the way would stay there.
    taken = ((people.target == found[:, None]) & people.present).any(axis=1)
    distance = norm(ends - start) + jnp.where(taken, TAKEN, 0.0)
    target = found[jnp.argmin(jnp.where(good, distance, jnp.inf))]
    goes = due[who] & good.any()
    goes_in = people.child[who] | (chance[0] < GOES_IN)
    inner = places.inner[target]
    goes_in = goes_in & _is_free(inner, people.radius[who], _parked(lot))
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
        # A person without a way lets the others look first.
        clock=jnp.where(own & due[who], 0.0, people.clock),
    )


def _is_free(xy: jax.Array, radius: jax.Array | float, boxes: jax.Array) -> jax.Array:
    """(...) bool, whether discs at points (..., 2) overlap none of boxes (6, m)."""
    x, y = offsets(xy[..., None, :], boxes)
    return (x * x + y * y > radius**2).all(axis=-1)


def _parked(lot: State) -> jax.Array:
    cars = lot.parked_cars
    return outlines(cars.pose_w, cars.size, cars.present)


def _find_near(people: People, lot: State) -> People:
    """People after every eighth has looked up the boxes that are near."""
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


def _apart(people: People, xy: jax.Array) -> Pair:
    """From the second people to the first (n, n) [m]; absent and own ones are far."""
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
    """Velocities (n, 2) [m/s] of attentive people out of the ways of cars."""
    here = enter.local(people.xy)
    on_way = enter.hold(here, people.radius[:, None])
    on_way = on_way & (jnp.abs(here[..., 1]) < stop.half[:, 1] + ASIDE)
    on_way = on_way & people.attentive[:, None]
    side = jnp.where(here[..., 1] < 0.0, -1.0, 1.0) * on_way
    x, y = -(side * enter.sin).sum(axis=1), (side * enter.cos).sum(axis=1)
    return columns(x, y)


@dataclasses.dataclass(frozen=True)
class Pedestrians(Mover):
    """People that walk between bays, entrances and ends of lanes.

    Shares are probabilities for each person, drawn when a lot begins.

    Attributes:
        number: how many, or the range that a lot draws from. A lot holds at most one
            for each place that can be reached when it begins.
        speed: desired speeds [m/s], normal about the middle of this range and cut at
            its ends, two standard deviations away. Weidmann 1993: 1.34 m/s, standard
            deviation 0.26 m/s.
        radius: of adults [m], uniform.
        attention: share of adults that give way to cars, or a range per lot.
        groups: share of adults that walk with the previous one.
        standing: share of adults that mostly stand.
        straight: share of adults that avoid nobody.
        children: share of people that run across aisles from between parked cars.
    """

    number: Annotated[int | tuple[int, int], Bounds(ge=0)] = 10
    speed: Annotated[Range, Bounds(ge=0.1, le=3.0, unit="m/s")] = (0.82, 1.86)
    radius: Annotated[Range, Bounds(ge=0.2, le=0.5, unit="m")] = (0.25, 0.35)
    attention: Annotated[float | Range, Bounds(ge=0.0, le=1.0)] = 0.8
    groups: Ratio = 0.2
    standing: Ratio = 0.1
    straight: Ratio = 0.1
    children: Ratio = 0.1
    mover: str = "pedestrians"
    kind = ObstacleKind.PERSON

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = _bounds(self.number)
        low, high = _bounds(self.attention)
        if not least <= most >= 1:
            raise ValueError(f"number must rise and be at least 1, not {self.number}")
        if low > high:
            raise ValueError(f"attention must rise, not {self.attention}")

    def init(
        self, key: jax.Array, layout: Layout, others: Sequence[Group] = ()
    ) -> People:
        """Everybody stands at a place of their own."""
        (least, n), places = _bounds(self.number), make_places(layout)
        bodies = group_outlines(others)
        room = self.radius[1] + START_SPARE
        keys = jax.random.split(key, 12)
        # At once, as each call of the generator is a loop; some keys draw otherwise.
        chances = jax.vmap(lambda key: jax.random.uniform(key, (n,)))(keys)
        order = jax.random.uniform(keys[0], places.mask.shape)
        # Of places too near to each other the last in order counts.
        near = norm(places.edge[:, None] - places.edge) < 2.0 * room
        near = near & (order > order[:, None]) & places.mask
        good = places.mask & ~near.any(axis=1) & _is_free(places.edge, room, bodies)
        order = jnp.argsort(jnp.where(good, order, 2.0))[:n]
        start = jnp.pad(order, (0, n - order.shape[0]))
        rank = jnp.arange(n)
        wanted = jax.random.randint(keys[1], (), least, n + 1)
        child = chances[2] < self.children
        # Of two neighbours in the list the second follows, so no follower leads.
        follows = (chances[3] < 2.0 * self.groups) & (rank % 2 == 1)
        follows = follows & ~child & ~jnp.roll(child, 1)
        angle = jax.random.uniform(keys[4], (TRIES, n), maxval=2 * jnp.pi)
        beside = 2.0 * room * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
        # Beside the leader, if there is room, clear of all others.
        tried = places.edge[jnp.roll(start, 1)] + beside
        walls = jnp.concatenate([bodies, places.walls], axis=1)
        away = norm(tried[:, :, None] - places.edge[start]) > 2.0 * room - START_SPARE
        away = (away | (rank[:, None] == rank)).all(axis=-1)
        free = _is_free(tried, room, walls) & away
        which = jnp.argmax(free, axis=0), rank
        at, follows = tried[which], follows & free.any(axis=0)
        meets = norm(at[:, None] - at) < 2.0 * room
        meets = meets & follows & (rank < rank[:, None])
        follows = follows & ~meets.any(axis=1)
        leader = jnp.where(follows, rank - 1, rank)
        start = start[leader]
        offset = jnp.where(follows[:, None], beside[which], 0.0)
        deviation = jax.random.truncated_normal(keys[5], -2.0, 2.0, (n,))
        low, high = self.speed
        speed = (low + high) / 2 + deviation * (high - low) / 4
        low, high = self.radius
        radius = jax.random.uniform(keys[6], (n,), minval=low, maxval=high)
        at = places.edge[start] + offset
        low, high = _bounds(self.attention)
        attention = jax.random.uniform(keys[11], minval=low, maxval=high)
        nothing = jnp.array([AWAY, AWAY, 1.0, 0.0, 0.0, 0.0])
        return People(
            xy=at,
            velocity=jnp.zeros((n, 2)),
            speed=speed[leader],
            radius=jnp.where(child, CHILD, radius),
            present=(rank < wanted) & (rank < good.sum()),
            child=child,
            stands=(chances[7] < self.standing)[leader] & ~child,
            straight=(chances[8] < self.straight) & ~child,
            attentive=(chances[9] < attention) & ~child,
            leader=leader,
            offset=offset,
            place=start,
            target=start,
            phase=jnp.full(n, REST, jnp.int32),
            inside=jnp.zeros(n, bool),
            clock=-FIRST_REST * chances[10][leader],
            halted=jnp.zeros(n),
            near=jnp.broadcast_to(nothing[:, None, None], (6, n, NEAR)),
            turn=jnp.int32(0),
            places=places,
        )

    begin = init

    def step(self, key: jax.Array, state: People, lot: State, dt: float) -> People:
        """They walk on."""
        return walk(key, state, lot, dt)

    def obstacles(self, state: People) -> list[Discs]:
        """A disc each."""
        return [Discs(state.xy, state.radius, state.velocity, state.present)]


def _bounds(value: Number | tuple[Number, Number]) -> tuple[Number, Number]:
    """The ends of a range; equal for one number."""
    return value if isinstance(value, tuple) else (value, value)


MOVERS.register("pedestrians", Pedestrians())

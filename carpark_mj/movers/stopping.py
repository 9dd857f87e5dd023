"""Where cars can no longer stop: nothing that moves by itself steps there.

A car that brakes fully as soon as its zone is entered hits nobody, so every collision
is avoidable. Cars are agents and drivers.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import move_forward, norm, wrap_angle
from carpark_mj.geometry.obstacles import Boxes, Group, ObstacleKind, touches
from carpark_mj.movers.bodies import AWAY, columns
from carpark_mj.types import State
from carpark_mj.vehicle.presets import CITY

MARGIN = 0.3  # m on all sides: the steering may still turn, brakes build up
STANDS = 1.0  # m, length of the zone of a car that stands, without the car
STILL = 1e-4  # m, what rounding may change of a gap
LIMITS = ("max_acceleration", "max_deceleration", "max_speed", "max_reverse_speed")


class Cars(NamedTuple):
    """Cars (n,) that people heed."""

    pose: jax.Array  # (n, 3) their centres; far away if they are not there
    size: jax.Array  # (n, 2) [m]
    speed: jax.Array  # forwards [m/s]
    yaw_rate: jax.Array  # [rad/s]
    accel: jax.Array  # at full pedal [m/s²]
    decel: jax.Array  # at full brake [m/s²]
    max_speed: jax.Array  # of the pedal forwards [m/s]
    max_reverse: jax.Array  # of the pedal backwards [m/s]


def cars_of(lot: State, dt: float) -> Cars:
    """The agents of a lot, and after them its drivers; `dt` is the control period."""
    motion, car = lot.motion, lot.physics.vehicle
    limits = (getattr(car, name) for name in LIMITS)
    agents = Cars(motion.pose_w, motion.size, motion.speed, motion.yaw_rate, *limits)
    driven = [
        _driven(group, dt)
        for group in lot.movers.groups
        if group.kind == ObstacleKind.DRIVER and isinstance(group, Boxes)
    ]
    if not driven:
        return agents
    return Cars(*map(jnp.concatenate, zip(agents, *driven, strict=True)))


def _driven(group: Group, dt: float) -> Cars:
    """Drivers, in cars that accelerate and brake as the preset `city` does."""
    pose, there = group.pose_w, group.mask
    if there is not None:
        pose = jnp.where(there[:, None], pose, AWAY)
    yaw, velocity = pose[:, 2], group.velocity_w
    speed = turn = jnp.zeros_like(yaw)
    if velocity is not None:
        speed = velocity[:, 0] * jnp.cos(yaw) + velocity[:, 1] * jnp.sin(yaw)
    if group.trace_w is not None and (steps := group.trace_w.shape[1]) > 1:
        turned = wrap_angle(group.trace_w[:, -1, 2] - group.trace_w[:, 0, 2])
        turn = turned * steps / ((steps - 1) * dt)
    limits = (jnp.full_like(yaw, getattr(CITY, name)) for name in LIMITS)
    return Cars(pose, group.size, speed, turn, *limits)


@struct.dataclass
class Zones:
    """Boxes about cars (n,) and what lies before them."""

    pose: jax.Array  # (n, 3) their centres
    cos: jax.Array  # (n,) of their headings
    sin: jax.Array  # (n,) of the heading
    half: jax.Array  # (n, 2) their half lengths and widths [m]
    ahead: jax.Array  # (..., n) from their centres forwards [m]
    behind: jax.Array  # (..., n) backwards [m]
    aside: jax.Array  # (n,) to either side [m]

    def hold(self, here: jax.Array, reach: jax.Array) -> jax.Array:
        """Whether discs of radii (n, 1) at `local` places (n, cars, 2) meet."""
        x, y = jnp.unstack(here, axis=-1)
        along = (x < self.ahead + reach) & (x > -self.behind - reach)
        return along & (jnp.abs(y) < self.aside + reach)

    def local(self, xy: jax.Array) -> jax.Array:
        """Points (n, 2) in the frames of the cars, (n, cars, 2)."""
        return self.turn(xy[:, None] - self.pose[:, :2])

    def turn(self, vector: jax.Array) -> jax.Array:
        """Vectors (n, 1 or cars, 2) in the frames of the cars."""
        x, y = jnp.unstack(vector, axis=-1)
        turned = self.cos * x + self.sin * y, self.cos * y - self.sin * x
        return jnp.stack(turned, axis=-1)


def stopping_zones(cars: Cars, dt: float, headway: jax.Array | float = 0.0) -> Zones:
    """What the cars of a lot sweep until they stand, or in a time if that is longer.

    `headway` is that time [s], broadcastable to (..., cars).
    """
    half, speed, accel, decel = cars.size / 2, cars.speed, cars.accel, cars.decel

    # Forwards and backwards.
    both = jnp.maximum(jnp.stack([speed, -speed]), 0.0)
    most = jnp.stack([cars.max_speed, cars.max_reverse])
    # It may speed up for a control step, at the end of which it sees, and then brakes.
    faster = jnp.maximum(both, jnp.minimum(both + accel * dt, most))
    stop = faster * dt + faster * faster / (2.0 * decel)
    extra = range(1, jnp.ndim(headway))
    both, stop = jnp.expand_dims(both, extra), jnp.expand_dims(stop, extra)
    way = half[:, 0] + jnp.maximum(stop, both * headway) + MARGIN
    # The heading turns with the speed until the car stands.
    turned = jnp.abs(cars.yaw_rate) * (dt + jnp.abs(speed) / (2.0 * decel))
    return Zones(
        pose=cars.pose,
        cos=jnp.cos(cars.pose[:, 2]),
        sin=jnp.sin(cars.pose[:, 2]),
        half=half,
        ahead=way[0],
        behind=way[1],
        aside=half[:, 1] + turned * cars.size[:, 0] + MARGIN,
    )


def would_hit(lot: State, pose: jax.Array, size: jax.Array, dt: float) -> jax.Array:
    """() bool, whether a box (3,), (2,) lies where a car cannot stop, or in a mover."""
    zones = stopping_zones(cars_of(lot, dt), dt)
    middle = move_forward(zones.pose, (zones.ahead - zones.behind) / 2)
    whole = jnp.stack([zones.ahead + zones.behind, 2.0 * zones.aside], axis=-1)
    return touches(pose[None], size, (Boxes(middle, whole), *lot.movers.groups))[0]


def keep_off(
    xy: jax.Array,
    move: jax.Array,
    goal: jax.Array,
    radius: jax.Array,
    enter: Zones,
    stop: Zones,
) -> jax.Array:
    """Moves (n, 2) [m] of discs, cut so that none is the cause of a collision.

    Discs do not enter a zone; they go along its edge, round a car that stands. A disc
    in a zone because a car came goes on, but where the car cannot stop neither nearer
    to the car nor to its path.

    Discs (n, 2), (n,) [m] head for goals (n, 2) [m]. Within the zones (n, cars) that
    they do not enter are those where cars cannot stop.
    """
    reach, here = radius[:, None], enter.local(xy)
    was_in, too_near = enter.hold(here, reach), stop.hold(here, reach)
    x, y = jnp.unstack(here, axis=-1)
    half_x, half_y = jnp.unstack(stop.half, axis=-1)

    def outward(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        return x - jnp.clip(x, -half_x, half_x), y - jnp.clip(y, -half_y, half_y)

    out_x, out_y = outward(x, y)
    square = out_x * out_x + out_y * out_y
    gap = jnp.sqrt(square)
    strip = half_y + reach
    beside = jnp.abs(y) >= strip

    def wrong(own: jax.Array) -> jax.Array:
        there = here + own
        there_x, there_y = jnp.unstack(there, axis=-1)
        beyond_x, beyond_y = outward(there_x, there_y)
        nearer = jnp.sqrt(beyond_x * beyond_x + beyond_y * beyond_y) < gap - STILL
        # Nor nearer to its way, where the car may come before they have passed.
        closes_in = beside & (jnp.abs(there_y) < jnp.abs(y) - STILL)
        return (enter.hold(there, reach) & ~was_in) | (too_near & (nearer | closes_in))

    # Along the edge of the zone, or round the car, of each; then of the nearest in the
    # way: choosing among results is cheaper than among what they are made of.
    own = enter.turn(move[:, None])
    bad = wrong(own)
    own_x, own_y = jnp.unstack(own, axis=-1)
    is_end = (x >= enter.ahead + reach) | (x <= -enter.behind - reach)
    # Past a car that stands by the end, or side, that is the shorter way.
    length, there = norm(move)[:, None], enter.local(goal)
    stands = enter.ahead + enter.behind - 2 * half_x < STANDS
    front = x + there[..., 0] > enter.ahead - enter.behind
    round_x = jnp.where(front, length, -length)
    round_y = jnp.where(y + there[..., 1] > 0.0, length, -length)
    edge_x, edge_y = (
        jnp.where(stands, a, b) for a, b in ((round_x, own_x), (round_y, own_y))
    )
    towards = jnp.minimum(own_x * out_x + own_y * out_y, 0.0) / (square + STILL**2)
    slid_x = jnp.where(was_in, own_x - towards * out_x, jnp.where(is_end, 0.0, edge_x))
    slid_y = jnp.where(was_in, own_y - towards * out_y, jnp.where(is_end, edge_y, 0.0))
    slid = (
        enter.cos * slid_x - enter.sin * slid_y,
        enter.sin * slid_x + enter.cos * slid_y,
    )
    car = jnp.argmin(jnp.where(bad, gap, jnp.inf), axis=1)[:, None]
    chosen = jnp.arange(bad.shape[1]) == car
    slid = [jnp.where(chosen, part, 0.0).sum(axis=1) for part in slid]
    move = jnp.where(bad.any(axis=1)[:, None], columns(*slid), move)
    stuck = wrong(enter.turn(move[:, None])).any(axis=1)
    return jnp.where(stuck[:, None], 0.0, move)

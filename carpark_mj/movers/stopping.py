"""Where cars can no longer stop: nothing that moves by itself steps there.

So a car that brakes fully as soon as someone is in its zone hits nobody, and every
contact could have been avoided.
"""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.geometry import boxes_overlap, move_forward
from carpark_mj.types import State

MARGIN = 0.3  # m on all sides: the steering may still turn, brakes build up
STILL = 1e-4  # m, what rounding may change of a gap


@struct.dataclass
class Zones:
    """Boxes about cars (num_agents,) and what lies before them.

    Attributes:
        xy: (num_agents, 2) their centres [m].
        cos: (num_agents,) of their headings.
        sin: (num_agents,) of the same.
        half: (num_agents, 2) their half lengths and widths [m].
        ahead: (..., num_agents) from their centres forwards [m].
        behind: (..., num_agents) backwards [m].
        aside: (num_agents,) to either side [m].
    """

    xy: jax.Array
    cos: jax.Array
    sin: jax.Array
    half: jax.Array
    ahead: jax.Array
    behind: jax.Array
    aside: jax.Array

    def hold(self, here: jax.Array, reach: jax.Array) -> jax.Array:
        """Whether discs of radii (n, 1) at `local` places (n, num_agents, 2) meet."""
        x, y = here[..., 0], here[..., 1]
        along = (x < self.ahead + reach) & (x > -self.behind - reach)
        return along & (jnp.abs(y) < self.aside + reach)

    def local(self, xy: jax.Array) -> jax.Array:
        """Points (n, 2) in the frames of the cars, (n, num_agents, 2)."""
        return self.turn(xy[:, None] - self.xy)

    def turn(self, vector: jax.Array) -> jax.Array:
        """Vectors (n, 1 or num_agents, 2) in the frames of the cars."""
        x, y = vector[..., 0], vector[..., 1]
        turned = self.cos * x + self.sin * y, self.cos * y - self.sin * x
        return jnp.stack(turned, axis=-1)


def stopping_distance(
    speed: jax.Array,
    max_speed: jax.Array,
    accel: jax.Array,
    decel: jax.Array,
    dt: float,
) -> jax.Array:
    """The way (...) [m] of a car that sees something and brakes.

    It may speed up for a control step, at the end of which it sees, and then brakes.

    Args:
        speed: in the direction of travel [m/s], at least 0.
        max_speed: of the pedal [m/s].
        accel: at full pedal [m/s²].
        decel: at full brake [m/s²].
        dt: control period [s].
    """
    faster = jnp.maximum(speed, jnp.minimum(speed + accel * dt, max_speed))
    return faster * dt + faster * faster / (2.0 * decel)


def stopping_zones(lot: State, dt: float, headway: jax.Array | float = 0.0) -> Zones:
    """What the cars of a lot sweep until they stand, or in a time if that is longer.

    Args:
        lot: its state.
        dt: control period [s].
        headway: times [s], broadcastable to (..., num_agents).
    """
    motion, car = lot.motion, lot.physics.vehicle
    half, speed = motion.size / 2, motion.speed
    accel, decel = car.max_acceleration, car.max_deceleration

    def way(speed: jax.Array, most: jax.Array) -> jax.Array:
        speed = jnp.maximum(speed, 0.0)
        stop = stopping_distance(speed, most, accel, decel, dt)
        return half[:, 0] + jnp.maximum(stop, speed * headway) + MARGIN

    # The heading turns with the speed until the car stands.
    turned = jnp.abs(motion.yaw_rate) * (dt + jnp.abs(speed) / (2.0 * decel))
    return Zones(
        xy=motion.xy,
        cos=jnp.cos(motion.pose_w[:, 2]),
        sin=jnp.sin(motion.pose_w[:, 2]),
        half=half,
        ahead=way(speed, car.max_speed),
        behind=way(-speed, car.max_reverse_speed),
        aside=half[:, 1] + turned * motion.size[:, 0] + MARGIN,
    )


def would_hit(lot: State, pose: jax.Array, size: jax.Array, dt: float) -> jax.Array:
    """() bool, whether a box (3,), (2,) lies where a car of the lot cannot stop."""
    zones = stopping_zones(lot, dt)
    middle = move_forward(lot.motion.pose_w, (zones.ahead - zones.behind) / 2)
    whole = jnp.stack([zones.ahead + zones.behind, 2.0 * zones.aside], axis=-1)
    return boxes_overlap(pose, size, middle, whole).any()


def keep_off(
    xy: jax.Array, move: jax.Array, radius: jax.Array, enter: Zones, stop: Zones
) -> jax.Array:
    """Moves (n, 2) [m] of discs, cut so that none is the cause of a collision.

    Nobody steps into a zone, but goes along its edge. Whoever is in one because a car
    came goes on, but where the car cannot stop neither nearer to it nor before it.

    Args:
        xy: (n, 2) centres [m].
        move: (n, 2) as wanted [m].
        radius: (n,) [m].
        enter: zones that nobody steps into, (n, num_agents).
        stop: zones where cars cannot stop, within those.
    """
    reach, here = radius[:, None], enter.local(xy)
    was_in, too_near = enter.hold(here, reach), stop.hold(here, reach)
    x, y = here[..., 0], here[..., 1]

    def outward(x: jax.Array, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        half_x, half_y = stop.half[:, 0], stop.half[:, 1]
        return x - jnp.clip(x, -half_x, half_x), y - jnp.clip(y, -half_y, half_y)

    out_x, out_y = outward(x, y)
    square = out_x * out_x + out_y * out_y
    gap = jnp.sqrt(square)
    strip = stop.half[:, 1] + reach
    beside = jnp.abs(y) >= strip

    def wrong(own: jax.Array) -> jax.Array:
        there = here + own
        beyond_x, beyond_y = outward(there[..., 0], there[..., 1])
        nearer = jnp.sqrt(beyond_x * beyond_x + beyond_y * beyond_y) < gap - STILL
        comes_before = beside & (jnp.abs(there[..., 1]) < strip)
        return (enter.hold(there, reach) & ~was_in) | (
            too_near & (nearer | comes_before)
        )

    # Along the edge of the zone, or round the car, of each; then of the nearest in the
    # way: choosing among results is cheaper than among what they are made of.
    own = enter.turn(move[:, None])
    bad = wrong(own)
    own_x, own_y = own[..., 0], own[..., 1]
    is_end = (x >= enter.ahead + reach) | (x <= -enter.behind - reach)
    towards = jnp.minimum(own_x * out_x + own_y * out_y, 0.0) / (square + STILL**2)
    slid_x = jnp.where(was_in, own_x - towards * out_x, jnp.where(is_end, 0.0, own_x))
    slid_y = jnp.where(was_in, own_y - towards * out_y, jnp.where(is_end, own_y, 0.0))
    slid = (
        enter.cos * slid_x - enter.sin * slid_y,
        enter.sin * slid_x + enter.cos * slid_y,
    )
    car = jnp.argmin(jnp.where(bad, gap, jnp.inf), axis=1)[:, None]
    chosen = jnp.arange(bad.shape[1]) == car
    slid = [jnp.where(chosen, part, 0.0).sum(axis=1) for part in slid]
    move = jnp.where(bad.any(axis=1)[:, None], jnp.stack(slid, axis=-1), move)
    stuck = wrong(enter.turn(move[:, None])).any(axis=1)
    return jnp.where(stuck[:, None], 0.0, move)

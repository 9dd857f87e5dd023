"""Distances to obstacles: rays of a laser scanner, rings that count, ultrasound."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Annotated

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import (
    Bounds,
    CheckedConfig,
    Count,
    Natural,
    NonNegative,
    Positive,
)
from carpark_mj.geometry import rotate
from carpark_mj.geometry.obstacles import (
    Boxes,
    Group,
    ObstacleKind,
    by_shape,
    is_crowded,
    joined,
    take,
    visit_near,
)
from carpark_mj.geometry.se2 import norm
from carpark_mj.observations.fields import Field, ObservationInput, Part
from carpark_mj.types import Motion, State


@dataclasses.dataclass(frozen=True)
class RayConfig(CheckedConfig):
    """Bearings along which the free distance is observed; none by default.

    Attributes:
        count: number of rays, evenly spaced about the car from straight ahead; 0 =
            none. Each measures the distance from the car's outline to the nearest wall,
            disc, parked car or agent.
        reach: longest distance measured [m].
        near: distance [m] up to which the free distance is observed a second time, in
            units of this distance, so that centimetres are visible; at most `reach`,
            0 = not observed twice.
    """

    count: Natural = 0
    reach: Positive = 10.0
    near: NonNegative = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.near > self.reach:
            raise ValueError(
                f"near must be at most the reach {self.reach}, not {self.near}"
            )


@dataclasses.dataclass(frozen=True)
class RingConfig(CheckedConfig):
    """Circles about the car that count the objects they touch; none by default.

    Attributes:
        diameters: diameters of the circles [m].
        cap: largest count a ring reports.
        cars: also count parked cars and other agents, not only walls and discs.
        history: number of past counts of every ring that are observed (n_h); they are
            0 at the start of an episode.
    """

    diameters: Annotated[tuple[float, ...], Bounds(gt=0.0)] = ()
    cap: Count = 2
    cars: bool = False
    history: Natural = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if len({f"{d:g}" for d in self.diameters}) < len(self.diameters):
            # Fields are named by the diameters.
            raise ValueError(f"ring diameters must be different, not {self.diameters}")
        if self.history and not self.diameters:
            raise ValueError(f"ring history {self.history} needs ring diameters")


@dataclasses.dataclass(frozen=True)
class UltrasoundConfig(CheckedConfig):
    """Twelve ultrasonic sensors around the car; off by default.

    Attributes:
        on: observe them.
        reach: longest distance measured [m].
        dead_zone: shortest distance measured [m]; what is nearer reads as this.
        cone: angle of a sensor's cone [rad].
        noise: standard deviation of the white noise [m].
    """

    on: bool = False
    reach: Positive = 5.0
    dead_zone: NonNegative = 0.15
    cone: Annotated[float, Bounds(gt=0.0, lt=math.pi, unit="rad")] = math.radians(60.0)
    noise: NonNegative = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.dead_zone >= self.reach:
            raise ValueError(
                f"dead_zone must be less than the reach {self.reach} m, not "
                f"{self.dead_zone}"
            )


RAYS = "rays"  # names of the fields
RAYS_NEAR = "rays_near"
CHUNK = 8  # obstacles whose rays are computed at a time in a crowded lot


@functools.cache
def rays_part(config: RayConfig) -> Part:
    """The field `rays`, and `rays_near` if the rays are to be seen in centimetres."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        free = cast_rays(config, sight.motion, sight.obstacles)
        if not config.near:
            return {RAYS: free}
        near = jnp.minimum(free * (config.reach / config.near), 1.0)
        return {RAYS: free, RAYS_NEAR: near}

    reach, near, free = config.reach, config.near, "free distance along"
    meaning = f"{free} bearings from ahead to the left [{reach:g} m]"
    count, mirror = config.count, (1, *range(config.count, 1, -1))
    fields = (Field(RAYS, count, 0.0, 1.0, meaning, mirror=mirror),)
    if config.near:
        meaning = f"{free} the bearings of `rays` [{near:g} m], clipped"
        fields += (Field(RAYS_NEAR, count, 0.0, 1.0, meaning, mirror=mirror),)
    return Part(fields, fill)


def cast_rays(
    config: RayConfig, motion: Motion, obstacles: Sequence[Group]
) -> jax.Array:
    """Free distance along the bearings (num_agents, count), divided by the reach.

    The rays start at the footprint's centre, the first one straight ahead, the others
    evenly spaced counter-clockwise in the body frame. The distance counts from the
    car's own outline to the nearest obstacle: 0 means touching at any bearing, 1 that
    no obstacle is within reach. It is exact for boxes and discs.
    """
    own_pose, own_size = motion.pose_w, motion.size
    count, reach = config.count, config.reach
    bearing = jnp.arange(count) * (2 * jnp.pi / count)
    ahead = jnp.stack([jnp.cos(bearing), jnp.sin(bearing)], axis=-1)
    direction = rotate(ahead, own_pose[:, None, 2])[:, None]  # (agents, 1, count, 2)
    # Once for a ray, not for each obstacle, which XLA would do to save memory.
    direction = jax.lax.optimization_barrier(direction)
    origin = own_pose[:, None, None, :2]
    outline = jnp.min(0.5 * own_size[:, None] / jnp.abs(ahead), axis=-1)
    free = outline + reach  # nothing farther away is seen
    for same in by_shape([group for group in obstacles if group.count]):
        them, counts = joined(same, own_pose.shape[0])
        gap = jnp.where(counts, them.gaps(own_pose[:, :2]), jnp.inf)
        free = _shorten(free, gap, them, origin, direction)
    return jnp.clip((free - outline) / reach, 0.0, 1.0)


def _shorten(
    free: jax.Array,
    gap: jax.Array,
    group: Group,
    origin: jax.Array,
    direction: jax.Array,
) -> jax.Array:
    """Free distances (num_agents, count) cut where they meet any of n obstacles.

    `gap` (num_agents, n): from the agents' centres to the obstacles, inf where none is.
    Rays begin at (num_agents, 1, 1, 2), along unit vectors (num_agents, 1, count, 2).
    """
    if not is_crowded(*gap.shape):
        found = take(group, None).ray_distance(origin, direction)
        found = jnp.where(jnp.isinf(gap)[..., None], jnp.inf, found)
        return jnp.minimum(free, jnp.min(found, axis=1, initial=jnp.inf))

    def visit(free: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        found = take(group, index).ray_distance(origin, direction)
        found = jnp.where(valid[..., None], found, jnp.inf)
        return jnp.minimum(free, jnp.min(found, axis=1))

    # An obstacle that begins beyond an agent's longest ray can shorten none of them.
    return visit_near(gap, lambda free: jnp.max(free, axis=1), visit, free, CHUNK)


def ring_fields(config: RingConfig, high: float, where: str) -> list[Field]:
    """The counts as agents observe them: now, then the past, the oldest first.

    `high` is their largest value, `where` ends their meaning: the circle and its unit.
    """
    objects = "walls and discs, cars too," if config.cars else "walls and discs"
    meaning = f"{objects} within {where}, capped"
    return [Field(name, 1, 0.0, high, meaning) for name in _ring_names(config)]


@functools.cache
def rings_part(config: RingConfig) -> Part:
    """The counts in units of the cap."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        counts = ring_counts(config, sight)
        return {name: count / config.cap for name, count in counts.items()}

    circle = f"the circle about the car [{config.cap}]"
    return Part(tuple(ring_fields(config, 1.0, circle)), fill)


def count_rings(config: RingConfig, sight: ObservationInput) -> jax.Array:
    """Counts (num_observers, rings) int32, up to the cap, about the sensed positions.

    Objects are walls, each counted once, discs, movers and, with `RingConfig.cars`,
    parked cars and other agents. No broad phase: the distance is the cheapest test.
    """
    motion = sight.motion
    cars = (ObstacleKind.AGENT, ObstacleKind.PARKED_CAR)
    seen = [group for group in sight.obstacles if config.cars or group.kind not in cars]
    gaps = []
    for same in by_shape(seen):
        them, counts = joined(same, motion.size.shape[0])
        gaps.append(jnp.where(counts, them.gaps(motion.xy), jnp.inf))
    gap = jnp.concatenate(gaps, axis=1)
    radii = jnp.array(config.diameters, gap.dtype) / 2
    count = jnp.sum(gap[:, :, None] < radii, axis=1)
    return jnp.minimum(count, config.cap)


def ring_counts(config: RingConfig, sight: ObservationInput) -> dict[str, jax.Array]:
    """Counts now and in the past by their fields' names, (num_observers, 1) each.

    The past is `State.memory`, see `init_history`.
    """
    if not config.diameters:
        return {}
    counts = count_rings(config, sight)
    if config.history:
        past = sight.state.memory["rings"].reshape(counts.shape[0], -1)
        counts = jnp.concatenate([counts, past], axis=1)
    return {name: counts[:, k : k + 1] for k, name in enumerate(_ring_names(config))}


def init_history(config: RingConfig, num_agents: int) -> dict[str, jax.Array]:
    """The part "rings" of `State.memory`, if the past is observed: zeros.

    Past counts (num_agents, history, rings) int32, oldest first.
    """
    shape = (num_agents, config.history, len(config.diameters))
    return {"rings": jnp.zeros(shape, jnp.int32)} if config.history else {}


def update_history(config: RingConfig, state: State) -> dict[str, jax.Array]:
    """The past once the counts of the state belong to it; see `init_history`."""
    if not config.history:
        return {}
    counts = count_rings(config, ObservationInput.of(state)).astype(jnp.int32)
    past = state.memory["rings"][:, 1:]
    return {"rings": jnp.concatenate([past, counts[:, None]], axis=1)}


def _ring_names(config: RingConfig) -> list[str]:
    now = [f"ring_{diameter:g}m" for diameter in config.diameters]
    past = range(config.history, 0, -1)
    return now + [f"{name}_ago_{ago}" for ago in past for name in now]


ULTRASOUND = "ultrasound"  # name of the field
_NOISE = 0x55535544  # separates its random numbers from others of a lot's key
# Half lengths ahead, half widths to the left, and yaw of the axis [deg]: four in each
# bumper and two on each side, as in a car that parks itself.
_FRONT = ((1.0, 0.9, 40.0), (1.0, 0.35, 5.0), (1.0, -0.35, -5.0), (1.0, -0.9, -40.0))
_SIDES = ((0.85, 1.0, 90.0), (-0.85, 1.0, 90.0))
SENSORS = (
    *_FRONT,
    *((-x, -y, yaw + 180.0) for x, y, yaw in _FRONT),
    *_SIDES,
    *((x, -y, -yaw) for x, y, yaw in _SIDES),
)


@functools.cache
def ultrasound_part(config: UltrasoundConfig) -> Part:
    """The field `ultrasound`."""

    def fill(sight: ObservationInput) -> dict[str, jax.Array]:
        distance = echo_distances(config, sight)
        if config.noise:
            key = jax.random.fold_in(sight.state.key, _NOISE)
            noise = config.noise * jax.random.normal(key, distance.shape)
            heard = distance < config.reach
            distance = jnp.where(heard, distance + noise, distance)
        distance = jnp.clip(distance, config.dead_zone, config.reach)
        return {ULTRASOUND: distance / config.reach}

    meaning = (
        "distance in the cones of the sensors: front and rear bumper, left and right "
        f"side [{config.reach:g} m]"
    )
    mirror = (4, 3, 2, 1, 8, 7, 6, 5, 11, 12, 9, 10)
    field = Field(ULTRASOUND, len(SENSORS), 0.0, 1.0, meaning, mirror=mirror)
    return Part((field,), fill)


def echo_distances(config: UltrasoundConfig, sight: ObservationInput) -> jax.Array:
    """Distances (num_observers, 12) [m] without noise; at most the reach."""
    motion = sight.motion
    x, y, yaw = jnp.array(SENSORS).T
    half = motion.size[:, None] / 2
    own_yaw = motion.pose_w[:, None, 2]
    mount = rotate(half * jnp.stack([x, y], axis=-1), own_yaw)
    origin = motion.xy[:, None] + mount  # (agents, sensors, 2)
    axis = own_yaw + jnp.radians(yaw)
    nearest = jnp.full(axis.shape, config.reach)
    for group in sight.obstacles:
        if group.count:
            found = _echoes(group, origin[:, None], axis[:, None], config.cone / 2)
            counts = group.counts(axis.shape[0])[..., None]
            found = jnp.where(counts, found, jnp.inf)
            nearest = jnp.minimum(nearest, jnp.min(found, axis=1))
    return nearest


def _echoes(
    group: Group, origin: jax.Array, axis: jax.Array, spread: float
) -> jax.Array:
    """Distances (agents, n, sensors) [m] to each of a group within cones.

    `origin` (agents, 1, sensors, 2) has their apexes [m], `axis` (agents, 1, sensors)
    the directions of their axes, `spread` is half their angle [rad]. The nearest point
    of a convex shape within a cone is the shape's nearest point, or else lies on an
    edge of the cone, so the distance is exact for boxes and discs.
    """
    offset = origin - group.pose_w[:, None, :2]
    if type(group) is Boxes:
        yaw = group.pose_w[:, None, 2]
        local = rotate(offset, -yaw)
        half = group.size[:, None] / 2
        way = rotate(jnp.clip(local, -half, half) - local, yaw)
        distance = norm(way)
    else:
        way, distance = -offset, jnp.maximum(norm(offset) - group.size[:, None], 0.0)
    ahead = way[..., 0] * jnp.cos(axis) + way[..., 1] * jnp.sin(axis)
    inside = ahead >= norm(way) * math.cos(spread)
    least = jnp.where(inside, distance, jnp.inf)
    for edge in (axis - spread, axis + spread):
        direction = jnp.stack([jnp.cos(edge), jnp.sin(edge)], axis=-1)
        least = jnp.minimum(least, group.ray_distance(origin, direction))
    return least

"""Pedestrians: who walks in a lot, drawn when it begins."""

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.config.checks import Range, require_count, require_range, require_ratio
from carpark_mj.config.obstacles import MOVERS, Mover, ObstacleKind
from carpark_mj.geometry import norm
from carpark_mj.geometry.obstacles import Discs, Group
from carpark_mj.layouts.types import Layout
from carpark_mj.movers.outlines import AWAY, group_outlines, offsets
from carpark_mj.movers.people import People
from carpark_mj.movers.places import make_places
from carpark_mj.movers.walking import NEAR, REST, walk
from carpark_mj.types import State

Number = TypeVar("Number", int, float)

CHILD = 0.25  # m, radius
FIRST_REST = 10.0  # s, longest until somebody sets out when a lot begins
SPARE = 0.01  # m of room about people when a lot begins
TRIES = 8  # places that are tried beside a leader


@dataclasses.dataclass(frozen=True)
class Pedestrians(Mover):
    """People who walk between bays, entrances and ends of lanes.

    Shares are probabilities for each person, drawn when a lot begins.

    Attributes:
        number: how many, or the range that a lot draws from; the most if `density` is
            given. A lot holds at most one for each place that can be reached when it
            begins.
        density: people for 100 m² of the lot, drawn from this range; None = `number`.
        speed: desired speeds [m/s], normal about the middle of this range and cut at
            its ends, two standard deviations away. Weidmann 1993: 1.34 m/s, standard
            deviation 0.26 m/s.
        radius: of adults [m], uniform.
        attention: share of adults who give way to cars, or the range that a lot draws
            it from.
        groups: share of adults who walk with the one before.
        standing: share of adults who mostly stand.
        straight: share of adults who walk straight whoever is near.
        children: share of people who run across aisles from between parked cars.
        mover: fixed.
    """

    number: int | tuple[int, int] = 10
    density: Range | None = None
    speed: Range = (0.82, 1.86)
    radius: Range = (0.25, 0.35)
    attention: float | Range = 0.8
    groups: float = 0.2
    standing: float = 0.1
    straight: float = 0.1
    children: float = 0.1
    mover: str = "pedestrians"
    kind = ObstacleKind.PERSON

    def __post_init__(self) -> None:
        super().__post_init__()
        least, most = _bounds(self.number)
        require_count("number", most, 1)
        require_range("number", (least, most), 0, most)
        if self.density is not None:
            require_range("density", self.density, 0.0, 100.0)
        require_range("attention", _bounds(self.attention), 0.0, 1.0)
        require_range("speed", self.speed, 0.1, 3.0)
        require_range("radius", self.radius, 0.2, 0.5)
        require_ratio(self, "groups", "standing", "straight", "children")

    def init(self, key: Any, layout: Layout, others: Sequence[Group] = ()) -> People:
        """Everybody stands at a place of their own."""
        (least, n), places = _bounds(self.number), make_places(layout)
        bodies = group_outlines(others)
        room = self.radius[1] + SPARE
        *keys, attention_key = jax.random.split(key, 12)
        keys = iter(keys)

        def share(probability: float | jax.Array) -> jax.Array:
            return jax.random.uniform(next(keys), (n,)) < probability

        order = jax.random.uniform(next(keys), places.mask.shape)
        # Of places too near to each other the last in order counts.
        near = norm(places.edge[:, None] - places.edge) < 2.0 * room
        near = near & (order > order[:, None]) & places.mask
        good = places.mask & ~near.any(axis=1) & _is_free(places.edge, room, bodies)
        order = jnp.argsort(jnp.where(good, order, 2.0))[:n]
        start = jnp.pad(order, (0, n - order.shape[0]))
        rank, number_key = jnp.arange(n), next(keys)
        wanted = jax.random.randint(number_key, (), least, n + 1)
        if self.density is not None:
            low, high = self.density
            density = jax.random.uniform(number_key, (), minval=low, maxval=high)
            area = 4.0 * layout.extent[0] * layout.extent[1]
            wanted = jnp.round(density * area / 100.0).astype(jnp.int32)
        child = share(self.children)
        # Of two neighbours in the list the second follows, so nobody leads a leader.
        follows = (
            share(2.0 * self.groups) & (rank % 2 == 1) & ~child & ~jnp.roll(child, 1)
        )
        angle = jax.random.uniform(next(keys), (TRIES, n), maxval=2 * jnp.pi)
        beside = 2.0 * room * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
        # Beside the leader, if there is room, clear of all others.
        tried = places.edge[jnp.roll(start, 1)] + beside
        walls = jnp.concatenate([bodies, places.walls], axis=1)
        away = norm(tried[:, :, None] - places.edge[start]) > 2.0 * room - SPARE
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
        deviation = jax.random.truncated_normal(next(keys), -2.0, 2.0, (n,))
        low, high = self.speed
        speed = (low + high) / 2 + deviation * (high - low) / 4
        low, high = self.radius
        radius = jax.random.uniform(next(keys), (n,), minval=low, maxval=high)
        at = places.edge[start] + offset
        low, high = _bounds(self.attention)
        attention = jax.random.uniform(attention_key, minval=low, maxval=high)
        return People(
            xy=at,
            velocity=jnp.zeros((n, 2)),
            speed=speed[leader],
            radius=jnp.where(child, CHILD, radius),
            present=(rank < wanted) & (rank < good.sum()),
            child=child,
            stands=share(self.standing)[leader] & ~child,
            straight=share(self.straight) & ~child,
            attentive=share(attention) & ~child,
            leader=leader,
            offset=offset,
            place=start,
            target=start,
            phase=jnp.full(n, REST, jnp.int32),
            inside=jnp.zeros(n, bool),
            clock=-jax.random.uniform(next(keys), (n,), maxval=FIRST_REST)[leader],
            halted=jnp.zeros(n),
            near=jnp.broadcast_to(
                jnp.array([AWAY, AWAY, 1.0, 0.0, 0.0, 0.0])[:, None, None],
                (6, n, NEAR),
            ),
            turn=jnp.int32(0),
            places=places,
        )

    def begin(self, key: Any, layout: Layout, others: Sequence[Group]) -> People:
        """Clear of others."""
        return self.init(key, layout, others)

    def step(self, key: Any, state: People, lot: State, dt: float) -> People:
        """They walk on."""
        return walk(key, state, lot, dt)

    def obstacles(self, state: People) -> list[Discs]:
        """A disc each."""
        return [Discs(state.xy, state.radius, state.velocity, state.present)]


def _is_free(xy: jax.Array, radius: float, boxes: jax.Array) -> jax.Array:
    """(...) bool, whether discs at points (..., 2) overlap none of boxes (6, m)."""
    x, y = offsets(xy[..., None, :], boxes)
    return (x * x + y * y > radius**2).all(axis=-1)


def _bounds(value: Number | tuple[Number, Number]) -> tuple[Number, Number]:
    """The ends of a range; those of one number are the same."""
    return value if isinstance(value, tuple) else (value, value)


MOVERS.register("pedestrians", Pedestrians())

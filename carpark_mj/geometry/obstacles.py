"""Groups of boxes and discs that cars can hit, and a broad phase for pairs of them.

A group has one shape and one kind. Both are static, so that needless computations are
never traced: walls stand still, and only agents leave themselves out.

In the broad phase every pair gets a cheap lower bound of its gap. The exact and costly
test then visits the pairs whose bound is below a limit, nearest first and a few per
agent at a time, until none is left. The result is exact in any lot, and the cost of the
tests grows with the number of near pairs. In small lots testing every pair is cheaper:
`is_crowded` decides by the static shapes, so that no key changes the program.
"""

import dataclasses
import enum
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.geometry import boxes
from carpark_mj.geometry.se2 import norm

Tree = TypeVar("Tree")


class ObstacleKind(enum.IntEnum):
    """What an obstacle is: events and metrics distinguish these by their labels."""

    AGENT = 0
    PARKED_CAR = 1
    WALL = 2  # all that a layout has: pillars and bollards too
    MOVER = 3
    PERSON = 4
    DRIVER = 5

    @property
    def label(self) -> str:
        """End of the names of events and metrics."""
        return self.name.lower()


@struct.dataclass
class Group:
    """Obstacles of a shape and a kind, (n,) in a lot; world frame."""

    pose_w: jax.Array  # (..., 3) centres and headings of boxes, (..., 2) of discs
    size: jax.Array  # (..., 2) lengths and widths of boxes, (...) radii of discs [m]
    velocity_w: jax.Array | None = None  # (..., 2) [m/s]; None = they stand still
    mask: jax.Array | None = None  # (...) bool, which of them there are; None = all
    # (n, k, 3 or 2) `pose_w` at the traced instants of the last control step, see
    # `Motion.trace_w`; None = they stood still
    trace_w: jax.Array | None = None
    kind: ObstacleKind = struct.field(pytree_node=False, default=ObstacleKind.MOVER)

    # Of boxes (pose, size) with this shape (pose_w, size).
    _overlap: ClassVar[Callable[..., jax.Array]]
    _distance: ClassVar[Callable[..., jax.Array]]
    _contact_time: ClassVar[Callable[..., jax.Array]]
    # Its outline, points (..., m, 2) of it that move farthest.
    _corners: ClassVar[Callable[..., jax.Array]]
    # Of points and rays with it.
    _gaps: ClassVar[Callable[..., jax.Array]]
    _ray_distance: ClassVar[Callable[..., jax.Array]]

    @property
    def count(self) -> int:
        """How many, absent ones included."""
        return self.pose_w.shape[0]

    @property
    def as_boxes(self) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        """Poses (..., 3), sizes and velocities (..., 2) and mask (...) of boxes.

        Discs are squares of heading 0.
        """
        pose, size, lead = self.pose_w, self.size, self.pose_w.shape[:-1]
        if not isinstance(self, Boxes):
            pose = jnp.concatenate([pose, jnp.zeros((*lead, 1))], axis=-1)
            size = jnp.stack([2.0 * size] * 2, axis=-1)
        velocity, mask = self.velocity_w, self.mask
        velocity = jnp.zeros((*lead, 2)) if velocity is None else velocity
        return pose, size, velocity, jnp.ones(lead, bool) if mask is None else mask

    @property
    def traced(self) -> Self:
        """At each of the traced instants (n, k); (n, 1) if they stood still."""
        trace = self.pose_w[:, None] if self.trace_w is None else self.trace_w
        return type(self)(trace, jnp.expand_dims(self.size, 1))

    def instant(self, number: int) -> Self:
        """The obstacles at one of the traced instants."""
        there = self.traced
        return dataclasses.replace(self, pose_w=there.pose_w[:, number], trace_w=None)

    @property
    def excursion(self) -> jax.Array:
        """Largest distances (n,) [m] of their points from where these end."""
        if self.trace_w is None:
            return jnp.zeros(self.count)
        there = self.traced
        corners = self._corners(there.pose_w, there.size)
        return norm(corners - corners[:, -1:]).max(axis=(1, 2))

    def counts(self, num_agents: int) -> jax.Array:
        """(num_agents, n) bool, which of them the first agents can hit: not itself."""
        if self.kind == ObstacleKind.AGENT:
            return ~jnp.eye(num_agents, self.count, dtype=bool)
        mask = jnp.ones(self.count, bool) if self.mask is None else self.mask
        return jnp.broadcast_to(mask, (num_agents, self.count))

    def gaps(self, xy: jax.Array) -> jax.Array:
        """Distances (m, n) [m] from points (m, 2); inside 0 or less."""
        return self._gaps(xy, self.pose_w, self.size)

    def overlap(self, pose: jax.Array, size: jax.Array) -> jax.Array:
        """Whether boxes (..., 3), (..., 2) overlap them; shapes broadcast."""
        return self._overlap(pose, size, self.pose_w, self.size)

    def hit(self, trace: jax.Array, size: jax.Array) -> jax.Array:
        """Whether boxes (..., k, 3), (..., 1, 2) hit these, traced, at k instants."""
        return self.overlap(trace, size)

    def distance(self, pose: jax.Array, size: jax.Array) -> jax.Array:
        """Gaps [m] to boxes (..., 3), (..., 2); 0 where they overlap."""
        return self._distance(pose, size, self.pose_w, self.size)

    def contact_time(
        self, pose: jax.Array, size: jax.Array, velocity: jax.Array
    ) -> jax.Array:
        """Times [s] until boxes of relative velocity (..., 2) hit them."""
        return self._contact_time(pose, size, self.pose_w, self.size, velocity)

    def ray_distance(self, origin: jax.Array, direction: jax.Array) -> jax.Array:
        """Distances (..., rays) [m] along rays (..., rays, 2) to each of them."""
        axis = self.pose_w.ndim - 1
        pose = jnp.expand_dims(self.pose_w, axis)
        size = jnp.expand_dims(self.size, axis)
        return self._ray_distance(origin, direction, pose, size)


@struct.dataclass
class Boxes(Group):
    """Boxes; see `Group`."""

    _overlap = staticmethod(boxes.boxes_overlap)
    _distance = staticmethod(boxes.box_distance)
    _contact_time = staticmethod(boxes.box_contact_time)
    _corners = staticmethod(boxes.box_corners)
    _gaps = staticmethod(
        lambda xy, pose, size: boxes.point_box_distance(xy[:, None], pose, size)
    )
    _ray_distance = staticmethod(boxes.ray_box_distance)


@struct.dataclass
class Discs(Group):
    """Discs; see `Group`."""

    _overlap = staticmethod(boxes.box_disc_overlap)
    _distance = staticmethod(boxes.box_disc_distance)
    _contact_time = staticmethod(boxes.box_disc_contact_time)
    _corners = staticmethod(lambda centre, radius: centre[..., None, :])
    _gaps = staticmethod(lambda xy, centre, radius: norm(xy[:, None] - centre) - radius)
    _ray_distance = staticmethod(boxes.ray_disc_distance)

    def hit(self, trace: jax.Array, size: jax.Array) -> jax.Array:
        """See `Group.hit`: discs may be thinner than the way between two instants."""
        passed = boxes.box_passes_disc(trace, size, self.pose_w, self.size)
        return self.overlap(trace, size) | passed


def touches(pose: jax.Array, size: jax.Array, groups: Sequence[Group]) -> jax.Array:
    """(n,) bool, whether boxes (n, 3), (n, 2) or (2,) overlap obstacles of groups."""
    found = jnp.zeros(pose.shape[:1], bool)
    size = jnp.broadcast_to(size, (*found.shape, 2))[:, None]
    for same in by_shape(groups):
        there, counts = joined(same, 1)
        found = found | (there.overlap(pose[:, None], size) & counts).any(1)
    return found


def joined(groups: Sequence[Group], num_agents: int) -> tuple[Group, jax.Array]:
    """Groups of one shape, at least one, as one, as they stand, and their `counts`."""
    pose = jnp.concatenate([group.pose_w for group in groups])
    size = jnp.concatenate([group.size for group in groups])
    # Joined once, not in each test, which hinders vectorisation on a CPU.
    group = type(groups[0])(*jax.lax.optimization_barrier((pose, size)))
    counts = [group.counts(num_agents) for group in groups]
    return group, jnp.concatenate(counts, axis=1)


def take(tree: Tree, index: Any) -> Tree:
    """Rows of a group: the arrays at an index."""
    return jax.tree.map(lambda x: x[index], tree)


class Merged(NamedTuple):
    """The groups of one shape as one."""

    group: Group  # all their obstacles, with traces, without velocities and masks
    counts: jax.Array  # (num_agents, n) bool, which of them each agent can hit
    excursion: jax.Array  # (n,) see `Group.excursion`
    kind: np.ndarray  # (n,) `ObstacleKind`, static


def merge(groups: Sequence[Group], num_agents: int) -> Merged:
    """Groups of one shape, at least one, as one."""
    traces = [group.traced.pose_w for group in groups]
    most = max(trace.shape[1] for trace in traces)
    traces = [jnp.broadcast_to(x, (len(x), most, x.shape[-1])) for x in traces]
    group, counts = joined(groups, num_agents)
    return Merged(
        dataclasses.replace(group, trace_w=jnp.concatenate(traces)),
        counts=counts,
        excursion=jnp.concatenate([group.excursion for group in groups]),
        kind=np.repeat([g.kind for g in groups], [g.count for g in groups]),
    )


def by_shape(groups: Sequence[Group]) -> list[Sequence[Group]]:
    """The groups of boxes, then those of discs; no empty list."""
    boxes = [group for group in groups if isinstance(group, Boxes)]
    discs = [group for group in groups if isinstance(group, Discs)]
    return [same for same in (boxes, discs) if same]


@struct.dataclass
class Movers:
    """The movers of a lot."""

    states: tuple[Any, ...] = ()  # their own, in the order of `EnvConfig.movers`
    # of each, at the end of the last control step, traced
    obstacles: tuple[tuple[Group, ...], ...] = ()

    @property
    def groups(self) -> tuple[Group, ...]:
        """The obstacles of all of them."""
        return tuple(group for own in self.obstacles for group in own)


NO_MOVERS = Movers()


# Pairs above which the bounds pay, measured on two CPU cores.
MANY_PAIRS = 500
# What float32 may lose of a bound at coordinates of some hundred metres.
MARGIN = 1e-3  # m

Carry = TypeVar("Carry")


def is_crowded(num_agents: int, num_others: int) -> bool:
    """Whether a lot has so many pairs of agents and others that the bounds pay."""
    return num_agents * num_others > MANY_PAIRS


def visit_near(
    bound: jax.Array,
    limit: Callable[[Carry], jax.Array],
    visit: Callable[[Carry, jax.Array, jax.Array], Carry],
    carry: Carry,
    chunk: int,
) -> Carry:
    """Visits for each agent everything whose bound is below its limit, nearest first.

    Args:
        bound: (num_agents, n) lower bounds [m]; inf or NaN is never visited.
        limit: of a carry, (num_agents,) [m]; it may shrink as the carry improves.
        visit: `(carry, index, valid) -> carry` with (num_agents, k) indices below n,
            each given once; those not valid must change nothing.
        carry: the first; the last is returned.
        chunk: how many to visit per agent at a time, k = min(chunk, n).
    """
    chunk = min(chunk, bound.shape[1])
    rows = jnp.arange(bound.shape[0])[:, None]

    def is_left(state: tuple[jax.Array, Carry]) -> jax.Array:
        bound, carry = state
        return jnp.any(jnp.min(bound, axis=1) < limit(carry))

    def go_on(state: tuple[jax.Array, Carry]) -> tuple[jax.Array, Carry]:
        bound, carry = state
        near, index = jax.lax.top_k(-bound, chunk)
        carry = visit(carry, index, -near < limit(carry)[:, None])
        return bound.at[rows, index].set(jnp.inf), carry

    if chunk == 0:
        return carry
    bound = jnp.where(jnp.isnan(bound), jnp.inf, bound)
    return jax.lax.while_loop(is_left, go_on, (bound, carry))[1]


def least_near(
    bound: jax.Array, find: Callable[[jax.Array], jax.Array], limit: float, chunk: int
) -> jax.Array:
    """The least number (num_agents,) of those found for each agent, at most `limit`.

    `bound` (num_agents, n) has lower bounds of the numbers, `find` gives the numbers
    (num_agents, k) at indices (num_agents, k); see `visit_near`.
    """

    def visit(least: jax.Array, index: jax.Array, valid: jax.Array) -> jax.Array:
        found = jnp.where(valid, find(index), jnp.inf)
        return jnp.minimum(least, jnp.min(found, axis=1))

    start = jnp.full(bound.shape[0], limit, bound.dtype)
    return visit_near(bound, lambda least: least, visit, start, chunk)

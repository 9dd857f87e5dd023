"""Places agents that begin an episode, one after the other, so that they stay apart.

Fixed and dynamic goals share the loop; see `spawning.goals`. A start that
overlaps an obstacle is rejected: an agent without a free start waits.
"""

import dataclasses
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.geometry import box_distance, boxes_overlap, norm
from carpark_mj.geometry.obstacles import (
    NO_MOVERS,
    Group,
    Movers,
    by_shape,
    joined,
    touches,
)
from carpark_mj.layouts.types import Layout
from carpark_mj.mdp.parked_cars import BayFits, in_bays
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import NO_BAY, ParkedCars, Vehicle


@struct.dataclass
class SpawnInputs:
    """Constants while the agents of a step are placed."""

    layout: Layout
    parked_cars: ParkedCars  # where they stood before the first is placed
    # (num_agents, 2) footprints of the cars drawn for agents that begin [m], and of
    # those they drove before; None if spawn regions have room for them all.
    size: jax.Array | None = None
    old_size: jax.Array | None = None
    fits: BayFits = BayFits()
    # (num_agents,) of the cars drawn; None = only the centres of cars are known.
    cars: Vehicle | None = None
    movers: Movers = NO_MOVERS
    # Whether only movers can be where an agent starts.
    clear: bool = struct.field(pytree_node=False, default=False)
    # Whether the lot begins: goals are given, and agents not placed yet are nowhere.
    first: bool = struct.field(pytree_node=False, default=False)


@struct.dataclass
class Placing:
    """Agents (num_agents,) while they are placed."""

    goal: jax.Array  # int32, see `State.goal`
    parked_bay: jax.Array  # (num_parked_cars,) int32, see `ParkedCars.bay`
    pose_w: jax.Array  # (num_agents, 3)
    waiting: jax.Array  # bool, still to be placed
    close_bay: jax.Array  # int32 free bay an exploring agent starts next to, or NO_BAY
    conflict: jax.Array  # bool, an exploring agent takes another's goal if possible
    # Bool, the agent gets the car drawn for it; if that fits into no bay it keeps its
    # goal and its car.
    found: jax.Array
    waited: jax.Array  # int32, see `State.waited`; the longest waiting come first
    tries: jax.Array  # int32 starts rejected; after the first, starts are random

    @property
    def xy(self) -> jax.Array:
        """(num_agents, 2) centres [m]."""
        return self.pose_w[:, :2]

    def set(self, agent: jax.Array, **values: jax.Array | bool | int) -> "Placing":
        """Replaces values of one agent (), by the names of the attributes."""
        # A choice joins its neighbours in one GPU kernel, `.at[agent].set` does not.
        own = jnp.arange(self.goal.shape[0]) == agent
        changes = {}
        for name, value in values.items():
            old = getattr(self, name)
            changes[name] = jnp.where(own[:, None] if old.ndim > 1 else own, value, old)
        return dataclasses.replace(self, **changes)


def start_placing(
    goal: jax.Array,
    parked_bay: jax.Array,
    pose_w: jax.Array,
    waiting: jax.Array,
    waited: jax.Array | None = None,
) -> Placing:
    """Agents before any is placed; arguments as in `Placing`."""
    zero = jnp.zeros(goal.shape, jnp.int32)
    return Placing(
        goal=goal,
        parked_bay=parked_bay,
        pose_w=pose_w,
        waiting=waiting,
        close_bay=jnp.full(goal.shape, NO_BAY, jnp.int32),
        conflict=jnp.zeros(goal.shape, bool),
        found=jnp.ones(goal.shape, bool),
        waited=zero if waited is None else waited,
        tries=zero,
    )


@struct.dataclass
class Surroundings:
    """The obstacles of one agent's start pose."""

    pose_w: jax.Array  # (num_agents, 3) the agents
    others: jax.Array  # (num_agents,) bool, the agents to keep away from
    # (num_agents, 2) footprints of the cars that agents drive or are about to drive,
    # whichever is larger [m]; None = unknown.
    outlines: jax.Array | None
    agent: jax.Array  # () int32 which agent it is
    size: jax.Array | None  # (2,) of its car [m]; None if it fits wherever it can spawn
    obstacles: tuple[Group, ...]  # all but the agents; starts do not overlap them
    movers: tuple[Group, ...] = ()  # of these; `min_distance` applies, as to agents
    # Whether only movers can be where an agent starts.
    clear: bool = struct.field(pytree_node=False, default=False)

    def distance(self, xy: jax.Array) -> jax.Array:
        """Distance (n,) [m] of points (n, 2) to the nearest agent's centre or mover."""
        gap = norm(xy[:, None] - self.pose_w[:, :2])
        least = jnp.where(self.others, gap, jnp.inf).min(axis=-1)
        return self._least(least, lambda movers: movers.gaps(xy))

    def room(self, pose: jax.Array) -> jax.Array:
        """Clearance (n,) [m] of the car at poses (n, 3) to other agents and movers."""
        if self.outlines is None:
            return self.distance(pose[:, :2])
        own = self.outlines[self.agent]
        gap = box_distance(pose[:, None], own, self.pose_w, self.outlines)
        least = jnp.where(self.others, gap, jnp.inf).min(axis=-1)
        return self._least(least, lambda movers: movers.distance(pose[:, None], own))

    def _least(self, least: jax.Array, find: Callable[[Group], jax.Array]) -> jax.Array:
        """Numbers (n,), or those (n, m) of movers where these are less."""
        for same in by_shape(self.movers):
            movers, counts = joined(same, 1)
            found = jnp.where(counts, find(movers), jnp.inf)
            least = jnp.minimum(least, found.min(axis=-1, initial=jnp.inf))
        return least

    def free(self, pose: jax.Array) -> jax.Array:
        """(n,) bool, whether the car at poses (n, 3) would overlap no obstacle."""
        if self.outlines is None:
            return (self.distance(pose[:, :2]) > 0.0) & ~self.touches(pose)
        own = self.outlines[self.agent]
        meets = boxes_overlap(pose[:, None], own, self.pose_w, self.outlines)
        return ~(meets & self.others).any(axis=-1) & ~self.touches(pose)

    def touches(self, pose: jax.Array) -> jax.Array:
        """(n,) bool, whether the car at poses (n, 3) would overlap any but agents."""
        if self.size is None:
            return jnp.zeros(pose.shape[:1], bool)
        return touches(pose, self.size, self.movers if self.clear else self.obstacles)

    def blocks(self, pose: jax.Array, size: jax.Array) -> jax.Array:
        """(n,) bool, whether a box (2,) [m] at poses (n, 3) overlaps `obstacles`."""
        return touches(pose, size, self.obstacles)


def surroundings(
    inputs: SpawnInputs, placing: Placing, agent: jax.Array, placed_only: bool = False
) -> Surroundings:
    """The obstacles of an agent's () start pose, goals and parked cars as in `placing`.

    With `placed_only` without agents that are still to be placed, which otherwise count
    where their last episodes ended.
    """
    size, outlines, parked = None, None, inputs.parked_cars
    if inputs.cars is not None:
        outlines = inputs.cars.size
        if inputs.old_size is not None:  # the larger of the old and the new car
            outlines = jnp.maximum(outlines, inputs.old_size)
    if inputs.size is not None and inputs.old_size is not None:
        found = placing.found[agent]
        size = jnp.where(found, inputs.size[agent], inputs.old_size[agent])
    if size is not None or inputs.cars is not None:
        parked = in_bays(inputs.layout, parked, placing.parked_bay)
    others = jnp.arange(placing.goal.shape[0]) != agent
    return Surroundings(
        pose_w=placing.pose_w,
        others=others & ~placing.waiting if placed_only else others,
        outlines=outlines,
        agent=agent,
        size=size,
        obstacles=lot_obstacles(inputs.layout, None, parked, inputs.movers),
        movers=inputs.movers.groups,
        clear=inputs.clear,
    )


Place = Callable[[SpawnInputs, Placing, jax.Array, jax.Array], Placing]
# In a lot with room for all (`has_room`) a quarter of all starts is free.
MAX_TRIES = 1000


def place_waiting(
    place: Place,
    inputs: SpawnInputs,
    placing: Placing,
    key: jax.Array,
    max_tries: int = MAX_TRIES,
    accept_last: bool = True,
) -> Placing:
    """Places the waiting agents; the others continue their episodes.

    A start that is not free is rejected, with the goal and the car drawn for it, and
    drawn again up to `max_tries` times. The last is taken, free or not, if
    `accept_last`; otherwise the agent goes on waiting. `key` is consumed.
    """
    num_agents = placing.goal.shape[0]
    keys = jax.random.split(key, 2 * num_agents)

    def due(placing: Placing) -> jax.Array:
        return placing.waiting & (placing.tries < max_tries)

    def one(placing: Placing) -> Placing:
        agent = jnp.argmax(jnp.where(due(placing), placing.waited, -1))
        tries = placing.tries[agent]
        again = jax.random.fold_in(keys[num_agents + agent], tries)
        key = jnp.where(tries == 0, keys[agent], again)
        placed = place(inputs, placing, agent, key).set(agent, waiting=False)
        around = surroundings(inputs, placed, agent, placed_only=True)
        made = around.free(placed.pose_w[agent][None])[0]
        if accept_last:
            made = made | (tries + 1 == max_tries)
        placing = jax.tree.map(lambda x, y: jnp.where(made, x, y), placed, placing)
        return placing.set(agent, tries=tries + 1)

    # The loop visits waiting agents only: in most steps no episode ends.
    return jax.lax.while_loop(lambda placing: due(placing).any(), one, placing)


FREE = 0.25  # least share of a region's points that are free at any heading


def has_room(
    layout: Layout, size: tuple[float, float], num_agents: int, spacing: float
) -> bool:
    """Whether the last agent always finds a free start in the largest spawn region.

    Another car occupies the centres at which boxes would overlap it: their Minkowski
    sum. That of two l x w boxes turned by t against each other has the area 2 l w +
    (l^2 + w^2) sin t + 2 l w cos t, and the perimeter 4 (l + w). `size` is that of the
    largest car [m], `spacing` as in `SpawnConfig`.
    """
    length, width = size
    both, squares = 2 * length * width, length**2 + width**2
    taken = both + math.hypot(squares, both)
    # A convex figure of area a and perimeter p holds at most a + p / 2 + 1 points of
    # the unit grid (Pick).
    taken += spacing * 2 * (length + width) + spacing**2
    sides = np.asarray(jax.device_get(layout.spawn_size), float)
    if spacing:
        sides = spacing * (2 * np.floor(0.5 * sides / spacing + 1e-4) + 1)
    area = np.where(layout.spawn_mask, sides[:, 0] * sides[:, 1], 0.0).max(initial=0.0)
    return bool((num_agents - 1) * taken <= (1 - FREE) * area)

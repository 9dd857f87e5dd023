"""Bays: which cars fit into which, and distinct bays drawn for cars."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.layouts.types import Layout
from carpark_mj.types import NO_BAY


class BayFits(NamedTuple):
    """Bays that cars of different sizes can use; None = all of them.

    Attributes:
        agents: (num_agents, bays) bool, bays that can be an agent's goal.
        parked_cars: (num_parked_cars, bays) bool, bays that a parked car can stand in.
    """

    agents: jax.Array | None = None
    parked_cars: jax.Array | None = None


def fits(bay_size: jax.Array, car_size: jax.Array, slack: float = 0.0) -> jax.Array:
    """Whether cars (..., 2) fit into bays (bays, 2) with `slack` to spare [m].

    Returns:
        (..., bays) bool.
    """
    return jnp.all(car_size[..., None, :] + slack <= bay_size, axis=-1)


def free_bays(layout: Layout, taken: jax.Array) -> jax.Array:
    """(bays,) bool, the bays of a lot less those in `taken` (k,) int32."""
    # No scatter: XLA on a CPU aborts where it fuses this one for a single agent.
    number = jnp.arange(layout.num_bays)
    return layout.bay_mask & (taken[:, None] != number).all(axis=0)


def marked(layout: Layout, bay: jax.Array) -> jax.Array:
    """(bays,) bool, true at the indices `bay` (k,) int32; `NO_BAY` marks nothing."""
    # No scatter, as in `free_bays`.
    return (bay[:, None] == jnp.arange(layout.num_bays)).any(axis=0)


def shuffled_bays(layout: Layout, key: jax.Array) -> jax.Array:
    """Indices (bays,) int32 in random order: bays for goals, reserved ones, padding."""
    score = jax.random.uniform(key, layout.bay_mask.shape)
    score = jnp.where(layout.goal_mask, score, score + 1.0)
    return jnp.argsort(jnp.where(layout.bay_mask, score, 3.0)).astype(jnp.int32)


class Wanted(NamedTuple):
    """Cars of several kinds that need bays.

    Attributes:
        fits: (cars, kinds, bays) bool.
        weights: (kinds,) > 0, how often each kind is drawn, in proportion.
        cars: (cars,) bool, the cars that need one.
        anywhere: whether a car that fits nowhere still gets a free bay.
    """

    fits: jax.Array
    weights: jax.Array
    cars: jax.Array
    anywhere: bool


def draw_bays(
    wanted: Wanted, free: jax.Array, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Draws kinds of cars and distinct bays for them, one car after the other.

    A kind is drawn by weight among those that fit into a bay still free, and then one
    of these bays.

    Args:
        wanted: the cars.
        free: (bays,) bool, bays to choose from.
        key: consumed.

    Returns:
        (cars,) int32 kinds and (cars,) int32 bays, `NO_BAY` where there is none.
    """
    num_bays = free.shape[0]

    def draw(free: jax.Array, car: tuple[jax.Array, jax.Array, jax.Array]):
        fits, wants, key = car
        kind_key, bay_key = jax.random.split(key)
        possible = (fits & free).any(axis=1)
        logits = jnp.log(wanted.weights)
        logits = jnp.where(possible | ~possible.any(), logits, -jnp.inf)
        kind = jax.random.categorical(kind_key, logits)
        good = free & fits[kind]
        if wanted.anywhere:
            good = jnp.where(good.any(), good, free)
        score = jax.random.uniform(bay_key, (num_bays,))
        bay = jnp.argmax(jnp.where(good, score, -1.0))
        bay = jnp.where(wants & good.any(), bay, NO_BAY).astype(jnp.int32)
        return free & (jnp.arange(num_bays) != bay), (kind.astype(jnp.int32), bay)

    keys = jax.random.split(key, wanted.cars.shape[0])
    return jax.lax.scan(draw, free, (wanted.fits, wanted.cars, keys))[1]


def bay_fits(
    config: EnvConfig, layout: Layout, agent_size: jax.Array, parked_size: jax.Array
) -> BayFits:
    """Bays that the cars of a lot can use; None where all cars are of one size.

    Agents of several kinds need the slack of the parked rule in force.

    Args:
        config: the fleet and the parked rule.
        layout: the lot.
        agent_size: (num_agents, 2) [m].
        parked_size: (num_parked_cars, 2) [m].
    """
    if not config.varies:
        return BayFits()
    agents = None
    if config.fleet.agents:
        slack = config.episode.slack
        agents = fits(layout.bay_size, agent_size, slack)
    return BayFits(agents, fits(layout.bay_size, parked_size))

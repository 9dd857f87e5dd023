"""Lots to look at: some cars, people and carts in any layout."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.config import LAYOUTS, GoalConfig, Mover, ObstacleKind, SpawnConfig
from carpark_mj.layouts import BayKind, layout_config, make_layout
from carpark_mj.obstacles import Boxes, Discs, Group

AT_RANDOM = SpawnConfig(close_ratio=0.0, conflict_ratio=0.0, reverse_ratio=0.0)
AGENTS, PARKED_CARS, PEOPLE = 2, 8, 3


@dataclasses.dataclass(frozen=True)
class Bystanders(Mover):
    """People who stand anywhere in the lot."""

    mover: str = "bystanders"
    kind = ObstacleKind.PERSON

    def init(self, key: Any, layout: Any) -> jax.Array:
        """Poses (n, 3)."""
        far = jnp.append(layout.extent, jnp.pi)
        return far * jax.random.uniform(key, (PEOPLE, 3), minval=-1.0)

    def step(self, key: Any, state: Any, lot: Any, dt: float) -> jax.Array:
        """They stay."""
        del key, lot, dt
        return state

    def obstacles(self, state: jax.Array) -> list[Group]:
        """All of them."""
        return [Discs(state[:, :2], jnp.full(PEOPLE, 0.3))]


@dataclasses.dataclass(frozen=True)
class Carts(Bystanders):
    """As many carts."""

    mover: str = "carts"
    kind = ObstacleKind.MOVER

    def obstacles(self, state: jax.Array) -> list[Group]:
        """All of them."""
        return [Boxes(state, jnp.broadcast_to(jnp.array([1.2, 0.7]), (PEOPLE, 2)))]


def families() -> list[str]:
    """A layout of every family, and the rest of those that no other looks like."""
    first: dict[str, str] = {}
    for name in LAYOUTS:
        first.setdefault(LAYOUTS[name].family, name)
    return sorted(first.values())


def environment(layout: str, people: bool = True, agents: int = AGENTS) -> ParkingEnv:
    """An environment with as many of the cars as its lots have bays for.

    Where lots have exits, agents drive out and nobody is parked.
    """
    lot = layout_config(layout)
    kinds = make_layout(lot, jax.random.key(0)).bay_kind
    exits = bool((kinds == BayKind.EXIT).any())
    agents = min(agents, lot.min_goals)
    parked_cars = 0 if exits else min(PARKED_CARS, lot.min_bays - agents)
    return ParkingEnv(
        EnvConfig(
            layout=layout,
            num_agents=agents,
            num_parked_cars=parked_cars,
            goals=GoalConfig(drive_out=exits),
            spawn=AT_RANDOM if exits else SpawnConfig(),
            movers=(Bystanders(), Carts()) if people else (),
        )
    )

"""Lots to look at: some cars, people and a cart in any layout."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.config import LAYOUTS, GoalConfig, Mover
from carpark_mj.layouts import BayKind, layout_config, make_layout
from carpark_mj.obstacles import Boxes, Discs

AGENTS, PARKED_CARS, PEOPLE = 2, 8, 3


@dataclasses.dataclass(frozen=True)
class Bystanders(Mover):
    """People and a cart that stand anywhere in the lot."""

    mover: str = "bystanders"

    def init(self, key: Any, layout: Any) -> jax.Array:
        """Poses (people and a cart, 3)."""
        far = jnp.append(layout.extent, jnp.pi)
        return far * jax.random.uniform(key, (PEOPLE + 1, 3), minval=-1.0)

    def step(self, key: Any, state: Any, lot: Any, dt: float) -> jax.Array:
        """They stay."""
        del key, lot, dt
        return state

    def obstacles(self, state: jax.Array) -> list[Boxes | Discs]:
        """Discs and a box."""
        people = Discs(state[:PEOPLE, :2], jnp.full(PEOPLE, 0.3))
        return [people, Boxes(state[PEOPLE:], jnp.array([[1.2, 0.7]]))]


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
            movers=(Bystanders(),) if people else (),
        )
    )

"""Parts of an observation: fields, and the function that fills them."""

import dataclasses
from collections.abc import Callable
from typing import Self, TypeVar

import jax
import jax.numpy as jnp

from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import Field
from carpark_mj.observations.sensors import observed
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.types import NO_BAY, Motion, State, Vehicle

Tree = TypeVar("Tree")


@dataclasses.dataclass(frozen=True)
class Sight:
    """What agents know of their lot.

    Attributes:
        state: of the lot.
        agents: measured motion of all (num_agents,); `state.motion` is the true one.
        num_observers: how many of them observe, the first; None = all, as in `values`
            of parts (num_agents, k).
        number: (num_agents,) numbers that give priority; None = 0, 1, 2...
    """

    state: State
    agents: Motion
    num_observers: int | None = None
    number: jax.Array | None = None

    @classmethod
    def of(cls, state: State) -> Self:
        """What all agents know."""
        return cls(state, observed(state))

    @property
    def motion(self) -> Motion:
        """Measured motion of the observers."""
        return self._of_observers(self.agents)

    @property
    def layout(self) -> Layout:
        """The lot's plan."""
        return self.state.layout

    @property
    def goal(self) -> jax.Array:
        """(num_observers,) bays."""
        return self._of_observers(self.state.goal)

    @property
    def tracked_bays(self) -> jax.Array:
        """(num_observers, num_tracked_bays) of agents that choose their goals."""
        assert self.state.tracked_bays is not None
        return self._of_observers(self.state.tracked_bays)

    @property
    def obstacles(self) -> tuple[Group, ...]:
        """All obstacles, agents first and at their measured poses."""
        state = self.state
        return lot_obstacles(state.layout, self.agents, state.parked_cars, state.movers)

    @property
    def vehicle(self) -> Vehicle:
        """The observers' cars."""
        return self._of_observers(self.state.physics.vehicle)

    def with_goal(self, values: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Values (num_observers, k) about the goal; zeros without a goal."""
        if self.state.tracked_bays is None:
            return values
        has_goal = (self.goal != NO_BAY)[:, None]
        return {name: jnp.where(has_goal, x, 0.0) for name, x in values.items()}

    def _of_observers(self, tree: Tree) -> Tree:
        if self.num_observers is None:
            return tree
        return jax.tree.map(lambda x: x[: self.num_observers], tree)


@dataclasses.dataclass(frozen=True)
class Part:
    """Neighbouring fields of a vector.

    Attributes:
        fields: in order.
        fill: their values (num_observers, field.size) by name.
    """

    fields: tuple[Field, ...]
    fill: Callable[[Sight], dict[str, jax.Array]]

"""Parts of an observation: fields, and the function that fills them."""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp

from carpark_mj.geometry.obstacles import Group
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import Field
from carpark_mj.obstacles.lot import lot_obstacles
from carpark_mj.types import Motion, State, Vehicle


@dataclasses.dataclass(frozen=True)
class Sight:
    """What agents know of their lot.

    Attributes:
        state: of the lot.
        motion: the agents (num_agents,) as their sensors tell; `state.motion` is true.
    """

    state: State
    motion: Motion

    @property
    def layout(self) -> Layout:
        """The lot's plan."""
        return self.state.layout

    @property
    def goal(self) -> jax.Array:
        """(num_agents,) bays."""
        return self.state.goal

    @property
    def obstacles(self) -> tuple[Group, ...]:
        """All there is to hit, agents first and where they are sensed."""
        state = self.state
        return lot_obstacles(state.layout, self.motion, state.parked_cars, state.movers)

    @property
    def vehicle(self) -> Vehicle:
        """The agents' cars (num_agents,)."""
        return self.state.physics.vehicle

    def with_goal(self, values: dict[str, jax.Array]) -> dict[str, jax.Array]:
        """Values (num_agents, k) that are about the goal: zeros without one."""
        if self.state.tracked_bays is None:
            return values
        has_goal = ~self.state.exploring[:, None]
        return {name: jnp.where(has_goal, x, 0.0) for name, x in values.items()}


@dataclasses.dataclass(frozen=True)
class Part:
    """Neighbouring fields of a vector.

    Attributes:
        fields: in order.
        fill: their values (num_agents, field.size) by name.
    """

    fields: tuple[Field, ...]
    fill: Callable[[Sight], dict[str, jax.Array]]

"""Goals: which bay an agent heads for, and how that is decided.

Two kinds behind one interface, chosen when an environment is built: `FixedGoals`, drawn
by the environment for each episode, and `DynamicGoals`, chosen by the agents themselves
at every step.
"""

from typing import Protocol

import jax

from carpark_mj.config import EnvConfig
from carpark_mj.mdp.dynamic_goals import DynamicGoals
from carpark_mj.mdp.fixed_goals import FixedGoals
from carpark_mj.mdp.spawning.placing import Placing, SpawnInputs
from carpark_mj.types import Events, GoalEvents, State


class Goals(Protocol):
    """How the goals of agents are decided."""

    def init_tracked_bays(self) -> jax.Array | None:
        """Tracked bays of a lot in which no agent tracks any yet, see `State`."""
        ...

    def track(self, state: State) -> State:
        """Updates tracked bays; goals that are no longer among them are lost."""
        ...

    def place_first(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> Placing:
        """Start pose of one agent () of a lot that begins; `key` is consumed."""
        ...

    def place(
        self, inputs: SpawnInputs, placing: Placing, agent: jax.Array, key: jax.Array
    ) -> Placing:
        """Goal and start pose of one agent () that begins an episode.

        Args:
            inputs: what stays the same for all agents of a step.
            placing: all agents; of this one where its last episode ended.
            agent: () int32 index.
            key: consumed.
        """
        ...

    def choose(self, state: State, choice: jax.Array | None) -> State:
        """Goals as the agents (num_agents,) choose them at the start of a step."""
        ...

    def target_bay(self, state: State) -> jax.Array:
        """The bay that each agent (num_agents,) heads for, `Transition.target_pose`."""
        ...

    def update(
        self, before: State, after: State, events: Events
    ) -> tuple[State, GoalEvents | None]:
        """Goals and tracked bays at the end of a step, before new episodes begin.

        Args:
            before: at the start of the step, goals not chosen yet.
            after: at its end, goals as chosen, parked cars relocated.
            events: of the step.
        """
        ...

    def begin(
        self, state: State, placing: Placing, begun: jax.Array, key: jax.Array | None
    ) -> State:
        """Goals and tracked bays of agents whose episodes have begun.

        Args:
            state: with all agents placed.
            placing: how they were placed.
            begun: (num_agents,) bool, who begins.
            key: consumed; None = no agent begins with a goal of its own choice.
        """
        ...


def make_goals(config: EnvConfig) -> Goals:
    """The goals that `GoalConfig.dynamic` asks for."""
    return DynamicGoals(config) if config.goals.dynamic else FixedGoals(config)

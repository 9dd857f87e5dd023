"""The interface of environments that roll-outs and adapters use."""

from typing import Any, Protocol, runtime_checkable

import jax

from carpark_mj.mdp.actions import ActionSpec


@runtime_checkable
class Environment(Protocol):
    """One lot, or junction; `jax.vmap` over keys and states gives a batch.

    States have a `key`, and tell which agents are `active` (num_agents,). Time steps
    have `observation`, `final_observation`, `reward`, `terminated`, `truncated` and
    `events`, these `success` and `crashed`, as `carpark_mj.types.TimeStep`.
    """

    @property
    def num_agents(self) -> int:
        """Agents in the lot."""
        ...

    @property
    def action_spec(self) -> ActionSpec:
        """What an agent's action consists of."""
        ...

    @property
    def respawns(self) -> bool:
        """Whether `step` begins the next episodes itself."""
        ...

    def reset(self, key: jax.Array, /) -> tuple[Any, jax.Array]:
        """A lot at its start, and its agents' observations (num_agents, ...)."""
        ...

    def step(self, state: Any, action: jax.Array, /) -> tuple[Any, Any]:
        """The next state, and what agents get from the step."""
        ...


class AgentsEnvironment(Environment, Protocol):
    """An environment whose agents have names, and wait when they have finished."""

    @property
    def agents(self) -> list[str]:
        """Names of the agents, in order."""
        ...

"""The interface of environments that roll-outs and adapters use; joint episodes."""

import dataclasses
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.types import State, TimeStep


@runtime_checkable
class Environment(Protocol):
    """One lot, or junction; `jax.vmap` over keys and states gives a batch.

    States have a `key` and a mask of agents, `active` (num_agents,). Time steps
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


class JointEnv(ParkingEnv):
    """A lot whose agents have one episode each, and leave when it ends.

    In multi-agent libraries an episode belongs to a group.

    Agents that had finished before a step, and absent agents, observe zeros, earn 0 and
    are terminated, so that learners do not bootstrap from them. The lot's episode ends
    when all agents are terminated or truncated.
    """

    def __init__(self, config: EnvConfig | None = None) -> None:
        """Builds the environment; `config.episode.respawn` has no effect."""
        config = config or EnvConfig()
        episode = dataclasses.replace(config.episode, respawn=False)
        super().__init__(dataclasses.replace(config, episode=episode))

    @property
    def agents(self) -> list[str]:
        """Names of the agents, in order."""
        return [f"agent_{k}" for k in range(self.num_agents)]

    def step(self, state: State, action: jax.Array) -> tuple[State, TimeStep]:
        """See `ParkingEnv.step`; `observation` is what agents see at the step's end."""
        waiting = ~state.active
        state, timestep = super().step(state, action)
        return state, dataclasses.replace(
            timestep,
            observation=jnp.where(waiting[:, None], 0.0, timestep.observation),
            terminated=timestep.terminated | waiting,
        )

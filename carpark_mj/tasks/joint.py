"""One episode per agent: agents that finish wait for the rest of the lot.

In multi-agent libraries an episode belongs to a group, and agents leave it one by one.
"""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.types import State, TimeStep


class JointEnv(ParkingEnv):
    """A lot whose agents have one episode each, and leave when it ends.

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

"""A lot as a JaxMARL environment: dicts by agent, everything under `jit` and `vmap`."""

# The library may be absent, and its environments all override its type of states.
# pyright: basic, reportMissingImports=false, reportIncompatibleMethodOverride=false

import dataclasses
from functools import partial
from typing import Any, Unpack

import jax
import jax.numpy as jnp
from gymnasium import spaces

import carpark_mj.physics.mjx_step  # isort: skip # noqa: F401 # quiet, if that loads MJX
from jaxmarl.environments.multi_agent_env import MultiAgentEnv
from jaxmarl.environments.spaces import Box, Dict, Discrete

from carpark_mj.mdp.goals import possible_choices
from carpark_mj.tasks.environment import AgentsEnvironment, JointEnv
from carpark_mj.types import ENDINGS
from carpark_mj.wrappers.batch import details, require_shape
from carpark_mj.wrappers.options import (
    Options,
    configure,
    discrete_table,
    observation_space,
    require_numbers,
    share,
)

Arrays = dict[str, jax.Array]


class JaxMarlAgents(MultiAgentEnv):
    """Agents with one episode each; `step` auto-resets the lot after the last ends.

    Observations (one agent's shape, or a dict of arrays with pictures), rewards () and
    dones () are dicts by agent; `dones["__all__"]` is that of the lot. An agent whose
    episode has ended stays done, observes zeros and earns 0; with `rewards.joint` of
    junctions it still earns the sum over all agents. Infos are (num_agents,) bool by
    outcome, True in the step in which an episode ends.
    """

    outcomes = ENDINGS

    def __init__(
        self, env: AgentsEnvironment, space: spaces.Box | spaces.Dict, options: Options
    ) -> None:
        """Wraps an environment in which agents that have finished wait for the others.

        It reads `discrete` and `details` of the options; without the first actions are
        numbers in [-1, 1].
        """
        super().__init__(env.num_agents)
        self._env = env
        act, table = Box(-1.0, 1.0, (env.action_spec.size,)), None
        rows = discrete_table(env.action_spec, options)
        require_numbers(env.action_spec, rows)
        if rows is not None:
            act, table = Discrete(len(rows)), jnp.asarray(rows)
        self._table, self._details = table, options.get("details", False)
        self._action_shape = (self.num_agents, *act.shape)
        self.observation_spaces = dict.fromkeys(self.agents, _space(space))
        self.action_spaces = dict.fromkeys(self.agents, act)

    @partial(jax.jit, static_argnums=(0,))
    def reset(self, key: jax.Array) -> tuple[Arrays, Any]:
        """Starts a lot; `key` is consumed."""
        state, observation = self._env.reset(key)
        return self._observed(observation), state

    def step_env(
        self, key: jax.Array, state: Any, actions: Arrays
    ) -> tuple[Arrays, Any, Arrays, Arrays, Arrays]:
        """A step without reset; it consumes `key` instead of the state's own."""
        action = jnp.stack([actions[agent] for agent in self.agents])
        require_shape("actions", action, self._action_shape)
        if self._table is not None:
            action = self._table[action]
        state, step = self._env.step(dataclasses.replace(state, key=key), action)
        done = step.terminated | step.truncated
        infos = {outcome: getattr(step.events, outcome) for outcome in self.outcomes}
        if self._details:
            infos |= details(step.motion, step.target_pose, step.reward_terms)
        return (
            self._observed(step.observation),
            state,
            self._by_agent(step.reward),
            self._by_agent(done) | {"__all__": done.all()},
            infos,
        )

    @partial(jax.jit, static_argnums=(0,))
    def get_avail_actions(self, state: Any) -> Arrays:
        """Masks (number of actions,) bool of discrete actions.

        All but those that choose a bay which the agent does not track.
        """
        number = 0 if self._table is None else len(self._table)
        masks = jnp.ones((self.num_agents, number), bool)
        choices = possible_choices(state)
        if choices is not None and self._table is not None:
            masks = choices[:, self._table[:, -1].astype(int)]
        return self._by_agent(masks)

    @property
    def name(self) -> str:
        """Name of the environment."""
        return "carpark_mj"

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """All agents are alike."""
        return {"car": self.agents}

    def _by_agent(self, values: jax.Array) -> Arrays:
        return dict(zip(self.agents, values, strict=True))

    def _observed(self, observation: jax.Array) -> dict[str, Any]:
        """Observations (num_agents, ...) by agent, dictionaries if with pictures."""
        unpack = getattr(self._env, "unpack", lambda seen: seen)
        return {k: unpack(seen) for k, seen in self._by_agent(observation).items()}


def _space(space: Any) -> Any:
    """A space of Gymnasium as one of JaxMARL."""
    if isinstance(space, spaces.Dict):
        return Dict({name: _space(part) for name, part in space.items()})
    bounds = jnp.asarray(space.low), jnp.asarray(space.high)
    return Box(*bounds, space.shape, jnp.dtype(space.dtype))


class JaxMarlParking(JaxMarlAgents):
    """A lot in which agents park; see `JaxMarlAgents`."""

    def __init__(self, **options: Unpack[Options]) -> None:
        """Builds the environment from `Options`."""
        config = configure(options)
        env, space = share(JointEnv, config), observation_space(config)
        super().__init__(env, space, options)

"""Greedy episodes of a torch policy, counted by the junction's own evaluation."""

# Extras that the type checker does without.
# pyright: basic, reportMissingImports=false

from collections.abc import Callable
from typing import Any

import jax
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carpark_mj.wrappers.torchrl import GROUP
from carpark_papers.cederle.benchmarl.config import BenchMARLConfig
from carpark_papers.cederle.junction.evaluation import (
    Outcomes,
    advance,
    begin,
    evaluation_env,
)
from carpark_papers.cederle.training.config import VECTOR_SCALE


class GreedyPolicy:
    """A policy of BenchMARL on JAX's arrays, from the start of a batch of episodes.

    Recurrent policies carry their memory.
    """

    def __init__(self, policy: Callable[[Any], Any], first: TensorDictBase) -> None:
        """Stands at the start of the episodes.

        Args:
            policy: actions of all agents.
            first: what its own environments begin with, (episodes,).
        """
        self._policy, self._seen = policy, first

    @torch.no_grad()
    def __call__(self, observation: jax.Array) -> jax.Array:
        """Actions (episodes, agents, ...) for observations (episodes, agents, n)."""
        # Divided into new memory: that of JAX may be used again.
        seen = self._seen.set(
            (GROUP, "observation"), torch.from_dlpack(observation) / VECTOR_SCALE
        )
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            seen = self._policy(seen)
        if "is_init" in seen:
            seen = seen.update(seen.pop("next"))
            seen["is_init"] = torch.zeros_like(seen["is_init"])
        self._seen = seen
        action = seen[GROUP, "action"].contiguous()
        if not action.is_floating_point():
            action = action.to(torch.int32)
        return jax.dlpack.from_dlpack(action)


class Evaluation:
    """Evaluates policies, always in the same episodes."""

    def __init__(self, config: BenchMARLConfig) -> None:
        """Builds the programs.

        Raises:
            ValueError: impossible settings.
        """
        self._env = env = evaluation_env(config.junction, config.eval_jitter)
        self._keys = config.evaluation_keys()
        self._begin = jax.jit(jax.vmap(lambda key: begin(env, key)))
        step = jax.vmap(lambda episode, action: advance(env, episode, action))
        self._step = jax.jit(step, donate_argnums=0)

    def __call__(self, act: Callable[[jax.Array], jax.Array]) -> Outcomes:
        """Drives the episodes, greedily if `act` does."""
        episodes = self._begin(self._keys)
        for _ in range(self._env.config.max_steps):
            action = act(episodes.observation)
            episodes = self._step(episodes, action)
        return jax.device_get(episodes.outcomes)

"""Greedy episodes of a torch policy, counted by the junction's own evaluation."""

# Extras that the type checker does without.
# pyright: basic, reportMissingImports=false

from collections.abc import Callable
from typing import Any

import jax
import torch
from tensordict import TensorDictBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carpark_mj.junction.evaluation import (
    Outcomes,
    advance,
    begin,
    evaluation_env,
)
from carpark_mj.wrappers.torchrl import GROUP
from learners.benchmarl.config import BenchMARLConfig
from learners.junction.config import VECTOR_SCALE


class GreedyEpisodes:
    """Evaluates a policy, always in the same episodes."""

    def __init__(self, config: BenchMARLConfig) -> None:
        """Builds the programs.

        Raises:
            ValueError: impossible settings.
        """
        self._env = env = evaluation_env(config.junction, config.eval_jitter)
        key = jax.random.fold_in(jax.random.key(config.seed), 1)
        self._keys = jax.random.split(key, config.eval_episodes)
        self._begin = jax.jit(jax.vmap(lambda key: begin(env, key)))
        step = jax.vmap(lambda episode, action: advance(env, episode, action))
        self._step = jax.jit(step, donate_argnums=0)

    @torch.no_grad()
    def __call__(self, policy: Callable[[Any], Any], first: TensorDictBase) -> Outcomes:
        """Drives the episodes.

        Args:
            policy: of BenchMARL.
            first: what a batch of its environments begins with, for what its networks
                keep in mind.
        """
        episodes, seen = self._begin(self._keys), first
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            for _ in range(self._env.config.max_steps):
                # Copied: the buffers of the episodes are used again.
                observation = torch.from_dlpack(episodes.observation) / VECTOR_SCALE
                seen = policy(seen.set((GROUP, "observation"), observation))
                action = seen[GROUP, "action"].contiguous()
                if not action.is_floating_point():
                    action = action.to(torch.int32)
                episodes = self._step(episodes, jax.dlpack.from_dlpack(action))
                if "is_init" in seen:  # recurrent: what it keeps in mind
                    seen = seen.update(seen.pop("next"))
                    seen["is_init"] = torch.zeros_like(seen["is_init"])
        return jax.device_get(episodes.outcomes)

"""The SAC of sbx as a run has it: made from settings, as arrays, as a policy."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from sbx import SAC
from stable_baselines3.common.vec_env import VecMonitor

from carpark_mj.config import LayoutConfig
from carpark_mj.wrappers.sb3 import ParkVecEnv
from carpark_papers.pandita.sac import replay
from carpark_papers.pandita.sac.config import SACConfig

ENVIRONMENT = "carpark_mj/Slots-v0"


class Agent(SAC):
    """SAC that waits with learning until its buffer can be sampled."""

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """As of `SAC`."""
        if replay.is_ready(self.replay_buffer):
            super().train(gradient_steps, batch_size)


def make_cars(config: SACConfig, layout: LayoutConfig, seed: int) -> VecMonitor:
    """All cars of a run, on lots of a layout."""
    env = ParkVecEnv(ENVIRONMENT, config.num_cars, config=config.env_of(layout))
    env.seed(seed)
    return VecMonitor(env)


def make_agent(
    config: SACConfig, cars: VecMonitor, rate: Callable[[float], float]
) -> Agent:
    """A fresh agent.

    Args:
        config: of the run.
        cars: of the first phase.
        rate: learning rate; called before every update, its argument means nothing.
    """
    buffer: dict[str, Any] = {"buffer_size": config.buffer_size}
    if config.replay == "her":
        buffer["replay_buffer_class"] = replay.PhasedHer
        buffer["replay_buffer_kwargs"] = {
            "n_sampled_goal": config.hindsight_goals,
            "copy_info_dict": False,  # relabelled ones hold no crash, as in the thesis
            "balance": config.at_switch == "balance",
        }
    if config.replay == "none":
        buffer["buffer_size"] = config.num_cars  # the last step's
    return Agent(
        "MultiInputPolicy",
        cars,
        learning_rate=rate,
        learning_starts=config.random_steps * config.num_cars,
        batch_size=config.batch_size,
        tau=config.tau,
        gamma=config.discount,
        gradient_steps=config.gradient_steps,
        target_entropy=config.target_entropy,
        policy_kwargs={"net_arch": list(config.hidden)},
        seed=config.seed,
        **buffer,
    )


def arrays(agent: Agent) -> dict[str, Any]:
    """Everything that learns, and the buffer, as a tree of arrays."""
    learning = {
        "actor": agent.policy.actor_state,
        "critics": agent.policy.qf_state,
        "temperature": agent.ent_coef_state,
        "keys": [agent.key, agent.policy.key, agent.policy.noise_key],
    }
    # Numbers among them are arrays only after the first update.
    learning = jax.tree.map(jnp.asarray, learning)
    return {**learning, "buffer": replay.snapshot(agent.replay_buffer)}


def put_back(agent: Agent, tree: dict[str, Any]) -> None:
    """Continues from what `arrays` gave."""
    agent.policy.actor_state, agent.policy.qf_state = tree["actor"], tree["critics"]
    agent.ent_coef_state = tree["temperature"]
    agent.key, agent.policy.key, agent.policy.noise_key = tree["keys"]
    replay.restore(agent.replay_buffer, tree["buffer"])


def set_seed(seed: int, steps: int) -> int:
    """Seeds what draws from NumPy's global state; returns the seed of the cars."""
    drawn = np.random.SeedSequence([seed, steps]).generate_state(2)
    np.random.seed(drawn[0])  # noqa: NPY002  the buffers of Stable-Baselines3 use it
    return int(drawn[1])

"""The SAC of sbx and its replay buffers, with phases and checkpoints."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false


# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import torch
from sbx import SAC
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from stable_baselines3.common.vec_env import VecMonitor

from carpark_mj.config import LayoutConfig
from carpark_mj.wrappers.sb3 import ParkVecEnv
from carpark_papers.pandita.sac.config import SACConfig

# What a buffer holds, and where it stands.
_ARRAYS = ("actions", "rewards", "dones", "timeouts")
_DICTS = ("observations", "next_observations")
_EPISODES = ("ep_start", "ep_length", "_current_ep_start", "phase_of_row")


class PhasedHer(HerReplayBuffer):
    """Hindsight replay whose samples are in random order, from all phases if asked.

    Stable-Baselines3 returns first the real transitions, then all relabelled ones, and
    sbx cuts a sample into the batches of several gradient steps. Unshuffled, the first
    batches would be real and the others relabelled.

    Attributes:
        phase: number of the phase of which transitions are added.
    """

    def __init__(self, *args: Any, balance: bool = False, **kwargs: Any) -> None:
        """See `HerReplayBuffer`; `balance` gives phases equal shares of a sample."""
        super().__init__(*args, **kwargs)
        self.phase, self._balance = 0, balance
        self.phase_of_row = np.zeros(self.buffer_size, np.int64)

    def add(self, *args: Any, **kwargs: Any) -> None:
        """See `HerReplayBuffer`."""
        self.phase_of_row[self.pos] = self.phase
        super().add(*args, **kwargs)

    def sample(self, batch_size: int, env: Any = None) -> DictReplayBufferSamples:
        """See `HerReplayBuffer`."""
        if self._balance:
            sample = _join(self._sample_phases(batch_size, env))
        else:
            sample = super().sample(batch_size, env)
        order = torch.from_numpy(np.random.permutation(batch_size))  # noqa: NPY002
        return _map(lambda part: part[order], sample)

    def _sample_phases(self, batch_size: int, env: Any) -> list[Any]:
        """A sample of each phase of which an episode has ended."""
        lengths = self.ep_length
        ended = np.unique(self.phase_of_row[(lengths > 0).any(axis=1)])
        samples: list[Any] = []
        try:
            for rows in np.array_split(np.arange(batch_size), len(ended)):
                here = self.phase_of_row == ended[len(samples)]
                # Rows of length 0 are not drawn.
                self.ep_length = np.where(here[:, None], lengths, 0)
                samples.append(super().sample(len(rows), env))
        finally:
            self.ep_length = lengths
        return samples


def _map(change: Callable[..., Any], *samples: Any) -> DictReplayBufferSamples:
    """Changes samples tensor by tensor."""
    return DictReplayBufferSamples(
        *(
            {name: change(*(part[name] for part in parts)) for name in parts[0]}
            if isinstance(parts[0], dict)
            else None
            if parts[0] is None
            else change(*parts)
            for parts in zip(*samples, strict=True)
        )
    )


def _join(samples: Sequence[Any]) -> DictReplayBufferSamples:
    return _map(lambda *parts: torch.cat(parts), *samples)


def end_episodes(buffer: DictReplayBuffer) -> None:
    """Ends the episodes under way, as if truncated: the next ones begin elsewhere."""
    if isinstance(buffer, HerReplayBuffer):
        with warnings.catch_warnings(action="ignore"):  # that it is done
            buffer.truncate_last_trajectory()


def clear(buffer: DictReplayBuffer) -> None:
    """Empties the buffer."""
    buffer.reset()
    if isinstance(buffer, HerReplayBuffer):
        buffer.ep_length[:] = 0
        buffer._current_ep_start[:] = 0


def is_ready(buffer: DictReplayBuffer) -> bool:
    """Whether there is something to sample: for hindsight an episode that has ended."""
    if isinstance(buffer, HerReplayBuffer):
        return bool((buffer.ep_length > 0).any())
    return buffer.size() > 0


def snapshot(buffer: DictReplayBuffer) -> dict[str, Any]:
    """The buffer as a tree of arrays; not copied."""
    tree = {name: getattr(buffer, name) for name in _ARRAYS + _DICTS}
    if isinstance(buffer, HerReplayBuffer):
        tree |= {name: getattr(buffer, name) for name in _EPISODES}
    return tree | {"position": np.array([buffer.pos, buffer.full])}


def restore(buffer: DictReplayBuffer, tree: dict[str, Any]) -> None:
    """Puts back what `snapshot` gave, with the episodes under way ended."""
    pos, full = map(int, tree.pop("position"))
    for name, value in tree.items():
        setattr(buffer, name, value)
    buffer.pos, buffer.full = pos, bool(full)
    end_episodes(buffer)


ENVIRONMENT = "carpark_mj/Slots-v0"


class Agent(SAC):
    """SAC that waits with learning until its buffer can be sampled."""

    def train(self, gradient_steps: int, batch_size: int) -> None:
        """As of `SAC`."""
        if is_ready(self.replay_buffer):
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

    `rate`, the learning rate, is called before every update; its argument means
    nothing.
    """
    buffer: dict[str, Any] = {"buffer_size": config.buffer_size}
    if config.replay == "her":
        buffer["replay_buffer_class"] = PhasedHer
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
    return {**learning, "buffer": snapshot(agent.replay_buffer)}


def put_back(agent: Agent, tree: dict[str, Any]) -> None:
    """Continues from what `arrays` gave."""
    agent.policy.actor_state, agent.policy.qf_state = tree["actor"], tree["critics"]
    agent.ent_coef_state = tree["temperature"]
    agent.key, agent.policy.key, agent.policy.noise_key = tree["keys"]
    restore(agent.replay_buffer, tree["buffer"])


def set_seed(seed: int, steps: int) -> int:
    """Seeds what draws from NumPy's global state; returns the seed of the cars."""
    drawn = np.random.SeedSequence([seed, steps]).generate_state(2)
    np.random.seed(drawn[0])  # noqa: NPY002  the buffers of Stable-Baselines3 use it
    return int(drawn[1])

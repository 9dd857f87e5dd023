"""Replay buffers of Stable-Baselines3: what a phase's end and a checkpoint need."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import warnings
from typing import Any

import numpy as np
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

# What a buffer holds, and where it stands.
_ARRAYS = ("actions", "rewards", "dones", "timeouts")
_DICTS = ("observations", "next_observations")
_EPISODES = ("ep_start", "ep_length", "_current_ep_start")


class ShuffledHer(HerReplayBuffer):
    """Hindsight replay whose samples are in random order.

    Stable-Baselines3 gives first the real transitions, then all relabelled ones, and
    sbx cuts a sample into the batches of several gradient steps: without this the first
    batches would be real, the others relabelled.
    """

    def sample(self, batch_size: int, env: Any = None) -> DictReplayBufferSamples:
        """As of `HerReplayBuffer`."""
        sample = super().sample(batch_size, env)
        order = torch.from_numpy(np.random.permutation(batch_size))  # noqa: NPY002
        return DictReplayBufferSamples(
            *(
                {name: value[order] for name, value in part.items()}
                if isinstance(part, dict)
                else None
                if part is None
                else part[order]
                for part in sample
            )
        )


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

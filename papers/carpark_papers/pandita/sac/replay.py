"""Replay buffers of Stable-Baselines3, with ends of phases and checkpoints."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false, reportUntypedBaseClass=false

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.buffers import DictReplayBuffer
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

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
        """See `HerReplayBuffer`.

        Args:
            *args: of `HerReplayBuffer`.
            balance: give all phases equal shares of a sample, whatever their lengths.
            **kwargs: of `HerReplayBuffer`.
        """
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
    """Changes tensor by tensor what samples hold at the same place."""
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

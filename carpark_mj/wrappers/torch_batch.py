"""A batch of lots as torch tensors on JAX's device, passed without copies by DLPack."""

# An extra that the type checker does without.
# pyright: reportMissingImports=false

from typing import Any

import jax
import torch

from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.tasks.environment import Environment
from carpark_mj.wrappers.batch import Batch, Seeds, Step


class TorchBatch:
    """A `Batch` whose tensors share memory with JAX's arrays, on their `device`.

    Tensors are never overwritten: the batch reuses only the buffers of its own state.
    """

    def __init__(self, env: Environment, num_lots: int, restart: bool = True) -> None:
        """See `Batch`."""
        self.batch = Batch(env, num_lots, restart)
        self.device = torch.from_dlpack(jax.numpy.zeros(1)).device

    def reset(self, seed: Seeds = None, options: ResetOptions | None = None) -> Any:
        """Begins all lots; see `Batch.reset`."""
        return jax.tree.map(torch.from_dlpack, self.batch.reset(seed, options))

    def restart(self, due: torch.Tensor) -> Any:
        """Resets some lots, `due` (num_lots,) bool; see `Batch.restart`."""
        observation = self.batch.restart(_to_jax(due, self.device))
        return jax.tree.map(torch.from_dlpack, observation)

    def step(self, action: torch.Tensor) -> Step:
        """Advances all lots by a control step; see `Batch.step`.

        NaN and actions out of range are sanitized and counted on the device
        (`carpark_mj.mdp.actions`); a check here would have to wait for the device.
        Actions (num_lots, num_agents, size) may require gradients, which end here.
        """
        dtype = torch.float32 if self.batch.env.action_spec.continuous else torch.int32
        timestep = self.batch.step(_to_jax(action.to(dtype), self.device))
        return Step.of(timestep, torch.from_dlpack)


def _to_jax(tensor: torch.Tensor, device: torch.device) -> jax.Array:
    if tensor.device != device:
        raise ValueError(f"tensors must be on {device}, as JAX is, not {tensor.device}")
    return jax.dlpack.from_dlpack(tensor.detach().contiguous())

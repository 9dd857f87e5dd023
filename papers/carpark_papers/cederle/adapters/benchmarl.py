"""The junction as a task of BenchMARL, for all of its algorithms by name.

Examples:
    >>> task = JunctionTask.JUNCTION.get_task({"scenario": "3av-hd"})
"""

# Its types do not fit its own use, and it may be absent.
# pyright: basic, reportMissingImports=false, reportArgumentType=false
# pyright: reportIncompatibleMethodOverride=false, reportReturnType=false

from collections.abc import Callable

import torch
from benchmarl.environments import Task, TaskClass
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from carpark_mj.wrappers.benchmarl import ParkingTaskClass, ending_rates
from carpark_papers.cederle.adapters.common import junction_env
from carpark_papers.cederle.adapters.torchrl import TorchRLJunction


class JunctionTaskClass(ParkingTaskClass):
    """A `TorchRLJunction`; the task's config holds its options.

    Algorithms of continuous actions choose by a scalar, all others by index.
    """

    def get_env_fun(
        self,
        num_envs: int,
        continuous_actions: bool,
        seed: int | None,
        device: torch.device | str,
    ) -> Callable[[], EnvBase]:
        """Makes `num_envs` junctions; `device` must be JAX's."""
        options = {"action": "scalar" if continuous_actions else "index"} | self.config
        return lambda: TorchRLJunction(num_envs, device=device, seed=seed, **options)

    def supports_continuous_actions(self) -> bool:
        """Unless the options ask for indices."""
        return self.config.get("action", "scalar") == "scalar"

    def supports_discrete_actions(self) -> bool:
        """Unless the options ask for scalars."""
        return self.config.get("action", "index") == "index"

    def max_steps(self, env: EnvBase) -> int:
        """Control steps after which every episode is over."""
        return junction_env(**self.config).config.max_steps

    @staticmethod
    def env_name() -> str:
        """In the names of runs."""
        return "carpark_mj_junction"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """Shares of the agents' episodes that ended in a batch."""
        rates = ending_rates(batch, "arrived")
        return {f"collection/{k}_rate": v for k, v in rates.items()}


class JunctionTask(Task):
    """The tasks: one, with many options."""

    JUNCTION = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """Of all tasks."""
        return JunctionTaskClass

    def get_from_yaml(self, path: str | None = None) -> TaskClass:
        """The task with default options or the options of a file."""
        return super().get_from_yaml(path) if path else self.get_task(config={})

"""Parking as a task of BenchMARL, for all of its algorithms by name.

Examples:
    >>> from benchmarl.algorithms import MappoConfig
    >>> from benchmarl.experiment import Experiment, ExperimentConfig
    >>> from benchmarl.models import MlpConfig
    >>> task = ParkingTask.PARK.get_task({"agents": 4})
    >>> experiment = Experiment(
    ...     task, MappoConfig.get_from_yaml(), MlpConfig.get_from_yaml(), seed=0,
    ...     critic_model_config=MlpConfig.get_from_yaml(),
    ...     config=ExperimentConfig.get_from_yaml(), callbacks=[Rates()],
    ... )
    >>> experiment.run()
"""

# Its types do not fit its own use, and it may be absent.
# pyright: basic, reportMissingImports=false, reportArgumentType=false
# pyright: reportIncompatibleMethodOverride=false, reportReturnType=false

from collections.abc import Callable
from typing import Any

import torch
from benchmarl.environments import Task, TaskClass
from benchmarl.experiment import Callback
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase

from carpark_mj.mdp.actions import action_spec
from carpark_mj.wrappers.options import configure
from carpark_mj.wrappers.torchrl import GROUP, TorchRLParking


class ParkingTaskClass(TaskClass):
    """A `TorchRLParking`; the task's config holds its options.

    Algorithms with continuous actions use steer and pedal, all others rows of
    `carpark_mj.wrappers.options`.
    """

    def get_env_fun(
        self,
        num_envs: int,
        continuous_actions: bool,
        seed: int | None,
        device: torch.device | str,
    ) -> Callable[[], EnvBase]:
        """Makes `num_envs` lots; `device` must be JAX's."""
        options = dict(self.config) | {"device": device, "seed": seed}
        discrete = not continuous_actions
        return lambda: TorchRLParking(num_envs, discrete=discrete, **options)

    def supports_continuous_actions(self) -> bool:
        """True unless some parts of an action are indices."""
        return not action_spec(configure(self.config)).choices

    def supports_discrete_actions(self) -> bool:
        """True, see `action_table`."""
        return True

    def max_steps(self, env: EnvBase) -> int:
        """Largest number of control steps of a lot's episode."""
        return configure(self.config).episode.max_steps

    def has_render(self, env: EnvBase) -> bool:
        """True: of the first lot."""
        return True

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """All agents in one group."""
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        """(agents, observation_size)."""
        return _only(env, "observation")

    def info_spec(self, env: EnvBase) -> Composite:
        """What happened in the step, (agents, 1) bool."""
        return _only(env, "info")

    def state_spec(self, env: EnvBase) -> None:
        """None: centralised critics and mixers read all agents' observations."""
        return None

    def action_spec(self, env: EnvBase) -> Composite:
        """(agents, 2), or (agents,) of discrete actions."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: EnvBase) -> Composite | None:
        """Of actions that choose bays; None where all are possible at all times."""
        mask = (GROUP, "action_mask") in env.observation_keys
        return _only(env, "action_mask") if mask else None

    @staticmethod
    def env_name() -> str:
        """In the names of runs."""
        return "carpark_mj"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """Shares of the agents' episodes that ended in a batch."""
        return {f"collection/{k}_rate": v for k, v in ending_rates(batch).items()}


def _only(env: EnvBase, name: str) -> Composite:
    """One entry of what the group observes."""
    spec = env.full_observation_spec_unbatched.clone()
    for other in {*spec[GROUP].keys()} - {name}:
        del spec[(GROUP, other)]
    return spec


class ParkingTask(Task):
    """The tasks: one, with many options."""

    PARK = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """Of all tasks."""
        return ParkingTaskClass

    def get_from_yaml(self, path: str | None = None) -> TaskClass:
        """The task with default options, or with those of a file."""
        return super().get_from_yaml(path) if path else self.get_task(config={})


class Rates(Callback):
    """Logs and keeps the outcomes of evaluated episodes.

    Attributes:
        history: a row for each evaluation: `frames` collected before it, and the rates
            `parked`, `crashed` and `truncated`.
    """

    def __init__(self) -> None:
        """Begins an empty history."""
        super().__init__()
        self.history: list[dict[str, float]] = []

    def on_evaluation_end(self, rollouts: list[TensorDictBase]) -> None:
        """Records the first episode of every lot, to which BenchMARL cuts roll-outs."""
        experiment: Any = self.experiment
        rates = ending_rates(torch.cat(rollouts))
        self.history.append({"frames": experiment.total_frames, **rates})
        experiment.logger.log(
            {f"eval/{name}_rate": rate for name, rate in rates.items()},
            step=experiment.n_iters_performed,
        )


def ending_rates(batch: TensorDictBase, success: str = "parked") -> dict[str, float]:
    """Shares of outcomes of the episodes that ended in steps (...); NaN if none did."""
    info = batch["next", GROUP, "info"]
    ends = {
        success: info[success],
        "crashed": info["crashed"],
        "truncated": batch["next", GROUP, "truncated"],
    }
    counts = torch.stack([ended.sum() for ended in ends.values()]).float()
    return dict(zip(ends, (counts / counts.sum()).tolist(), strict=True))

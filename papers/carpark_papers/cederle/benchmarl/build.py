"""BenchMARL's parts from a configuration, and greedy episodes of its policies."""

# Extras that the type checker does without.
# pyright: basic, reportMissingImports=false


# Its types do not fit its own use, and it may be absent.
# pyright: basic, reportMissingImports=false, reportArgumentType=false

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import torch
from benchmarl.algorithms import algorithm_config_registry
from benchmarl.algorithms.common import AlgorithmConfig
from benchmarl.experiment import ExperimentConfig
from benchmarl.models import GruConfig, MlpConfig
from benchmarl.models.common import ModelConfig, SequenceModelConfig
from tensordict import TensorDict, TensorDictBase
from torch import nn
from torchrl.envs import Compose, EnvBase, ObservationNorm, RewardScaling, Transform
from torchrl.envs.utils import ExplorationType, set_exploration_type

from carpark_mj.wrappers.torchrl import GROUP
from carpark_papers.cederle.adapters.benchmarl import JunctionTaskClass
from carpark_papers.cederle.adapters.torchrl import TorchRLJunction
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
        """Stands where its own environments begin, `first` (episodes,)."""
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
    """Evaluates policies in fixed episodes."""

    def __init__(self, config: BenchMARLConfig) -> None:
        """Builds the programs."""
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


# Returns of `ippo` and `mappo` are divided by it: an agent's come to 40 to 80,
# and critics that begin at 0 took 300,000 control steps to get there.
REWARD_SCALE = 20.0


class HeldActions(TorchRLJunction):
    """Junctions at which an action is held for some control steps."""

    def __init__(self, junctions: int, *, repeat: int, **options: Any) -> None:
        """Takes the number of junctions, and options of `TorchRLJunction`."""
        super().__init__(junctions, **options)
        self._repeat = repeat

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        # Agents that are done earn nothing more, and stay so.
        reward = 0.0
        for _ in range(self._repeat):
            step = super()._step(tensordict)
            reward = reward + step[GROUP, "reward"]
        return step.set((GROUP, "reward"), reward)


class ScaledJunctionTask(JunctionTaskClass):
    """The junction with observations of order 1.

    Attributes:
        repeat: control steps for which an action is held in training.
    """

    repeat: int = 1

    def get_env_transforms(self, env: EnvBase) -> list[Transform]:
        """Divides observations by `VECTOR_SCALE`."""
        keys, scale = [(GROUP, "observation")], 1 / VECTOR_SCALE
        return [ObservationNorm(0.0, scale, in_keys=keys, standard_normal=False)]

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Makes `num_envs` junctions at which actions are held."""
        options = {"action": "scalar" if continuous_actions else "index"} | self.config
        return lambda: HeldActions(
            num_envs, device=device, seed=seed, repeat=self.repeat, **options
        )


class ScaledRewardsTask(ScaledJunctionTask):
    """A task with rewards that a critic learns within few updates."""

    def get_reward_sum_transform(self, env: EnvBase) -> Transform:
        """Sums rewards as they are, then divides them by `REWARD_SCALE`."""
        scaling = RewardScaling(
            0.0, 1 / REWARD_SCALE, in_keys=[(GROUP, "reward")], standard_normal=False
        )
        return Compose(super().get_reward_sum_transform(env), scaling)


def make_task(config: BenchMARLConfig) -> ScaledJunctionTask:
    """The junction of the training."""
    task = ScaledRewardsTask if config.on_policy else ScaledJunctionTask
    junction = config.junction
    options = {
        field.name: getattr(junction, field.name)
        for field in dataclasses.fields(junction)
        if field.name != "respawn"
    }
    made = task(name="JUNCTION", config=options)
    made.repeat = config.repeat
    return made


def make_algorithm(config: BenchMARLConfig) -> AlgorithmConfig:
    """The algorithm."""
    algorithm: Any = algorithm_config_registry[config.algorithm].get_from_yaml()
    if config.algorithm in ("ippo", "mappo", "maddpg"):
        algorithm.share_param_critic = config.shared
    if config.on_policy:
        algorithm.entropy_coef, algorithm.clip_epsilon = config.entropy, config.clip
        algorithm.lmbda = config.gae_lambda
    return algorithm


def make_model(config: BenchMARLConfig) -> ModelConfig:
    """The networks of actors and of critics."""
    layers = MlpConfig(
        num_cells=config.hidden,
        layer_class=nn.Linear,
        activation_class=nn.Tanh if config.on_policy else nn.ReLU,
    )
    if not config.recurrent:
        return layers
    recurrent = GruConfig(
        hidden_size=config.recurrent,
        n_layers=1,
        bias=True,
        dropout=0.0,
        compile=False,
        mlp_num_cells=[],
        mlp_layer_class=nn.Linear,
        mlp_activation_class=nn.ReLU,
    )
    # An MLP ends in a linear layer, which comes behind all hidden ones.
    return SequenceModelConfig([layers, recurrent], [config.hidden[-1]])


def make_settings(
    config: BenchMARLConfig, folder: Path, device: torch.device
) -> ExperimentConfig:
    """BenchMARL's own settings.

    Evaluations, logs and checkpoints are ours; `checkpoint_interval` calls for them
    after every iteration.
    """
    settings: Any = ExperimentConfig.get_from_yaml()
    settings.sampling_device = settings.train_device = str(device)
    settings.buffer_device = str(device)
    settings.share_policy_params = config.shared
    settings.prefer_continuous_actions = config.action == "scalar"
    settings.gamma, settings.lr = config.discount, config.learning_rate
    settings.clip_grad_norm, settings.clip_grad_val = True, config.max_gradient
    settings.soft_target_update, settings.polyak_tau = True, config.tau
    settings.exploration_eps_init = config.epsilon_start
    settings.exploration_eps_end = config.epsilon_end
    settings.exploration_anneal_frames = -(-config.epsilon_steps // config.repeat)
    settings.max_n_frames = config.iterations * config.decisions
    settings.on_policy_collected_frames_per_batch = config.decisions
    settings.on_policy_n_envs_per_worker = config.num_junctions
    settings.on_policy_n_minibatch_iters = config.updates
    settings.on_policy_minibatch_size = config.batch_size
    settings.off_policy_collected_frames_per_batch = config.decisions
    settings.off_policy_n_envs_per_worker = config.num_junctions
    settings.off_policy_n_optimizer_steps = config.updates
    settings.off_policy_train_batch_size = config.batch_size
    settings.off_policy_memory_size = config.buffer_size
    unrolls = math.ceil(config.random_steps / config.frames)
    settings.off_policy_init_random_frames = unrolls * config.decisions
    settings.evaluation, settings.evaluation_episodes = False, config.eval_episodes
    settings.checkpoint_interval = config.decisions
    settings.loggers, settings.create_json = [], False
    settings.save_folder = str(folder)
    return settings

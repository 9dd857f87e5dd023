"""Settings of PPO training and of its curricula."""

import dataclasses
from typing import Annotated

import jax
import jax.numpy as jnp

from carpark_mj.cli.settings.training import TrainConfig
from carpark_mj.config import EnvConfig, data
from carpark_mj.config.checks import (
    LARGEST_WHOLE,
    Bounds,
    CheckedConfig,
    Count,
    Natural,
    NonNegative,
    Positive,
    Ratio,
)
from carpark_mj.config.networks import NetworkConfig
from carpark_mj.training.ppo.parts import BRAX, VARIANTS


@dataclasses.dataclass(frozen=True)
class CurriculumConfig(CheckedConfig):
    """Settings of training that evaluations do not have; all off by default.

    Progress is the share of the training that is over.

    Attributes:
        crash_scale: factor on the penalties `crash` and `person`, which rises linearly
            from 1 until progress `crash_until`. With the full penalty from the start
            agents learn to stand still.
        crash_until: progress at which the factor is reached.
        discount_end: discount factor at the end; 0 = that of the start. From progress
            0.3 to 0.8 the horizon, 1 / (1 - discount), changes linearly.
        conflict_ratio: share of spawns in conflict with agents; 0 = the environment's.
        reverse_ratio: share of starts on a reversed exit path of the bay; 0 likewise.
        misaligned_ratio: share of starts in the bay, askew or on lines; 0 likewise.
        target_rate: success rate, of episodes weighted by their steps, to reach in
            every family of a mixture: half of the new lots (`lot_life`) favour families
            and numbers of agents far below it. 0 = off; no effect on a single layout or
            without `lot_life`.
        neighbour_share: weight, at the end, of the mean advantage of the other agents
            within 15 m, which is added to an agent's own. 0 until progress 0.2, then
            rising linearly until 0.6. One agent has no neighbours.
        teacher: policy to imitate at the states that the agents reach (DAgger): a name,
            run or checkpoint; "" = none. It observes what it was trained on.
        teacher_cost: weight, at the start, of the squared distance to its actions.
        teacher_until: progress at which that weight, falling linearly, is 0.
    """

    crash_scale: NonNegative = 1.0
    crash_until: Ratio = 0.7
    discount_end: Annotated[float, Bounds(ge=0.0, lt=1.0)] = 0.0
    conflict_ratio: Ratio = 0.0
    reverse_ratio: Ratio = 0.0
    misaligned_ratio: Ratio = 0.0
    target_rate: Ratio = 0.0
    neighbour_share: NonNegative = 0.0
    teacher: str = ""
    teacher_cost: NonNegative = 1.0
    teacher_until: Ratio = 0.5


@dataclasses.dataclass(frozen=True)
class PPOConfig(TrainConfig):
    """Settings of `carpark_mj train`; every field is a flag.

    The settings of `TrainConfig` come first.

    Attributes:
        warm_start: run whose networks the training starts from instead of random ones:
            folder, checkpoint, or name of a pretrained policy with `critic_steps`.
        lot_life: largest number of updates before a random lot is replaced; a few are
            replaced after every update. 0 = never.
        stored_lots: number of lots drawn once and kept in the user's cache
            (`carpark_mj.layouts.stored`), for mixtures that take long to compile; 0 =
            lots are drawn during the training. Evaluation draws its own.
        unroll_length: control steps between updates.
        num_minibatches: number of minibatches per epoch.
        num_epochs: passes over the data of an update.
        learning_rate: Adam's learning rate at the start.
        learning_rate_end: learning rate at the end; linear in between.
        entropy_cost: weight of the entropy bonus at the start.
        entropy_cost_end: weight of the entropy bonus at the end; linear in between.
        clip: PPO's clipping of the probability ratio at the start.
        clip_end: clipping of the probability ratio at the end; linear in between.
        discount: discount factor per control step, at the start.
        gae_lambda: lambda of generalised advantage estimation.
        max_grad_norm: global norm to which gradients are clipped.
        half_precision: inner layers in bfloat16 in training; set encoder only.
        variant: details of the algorithm: `brax`, or of a study, as `ml-agents`.
        averaged_updates: the policy that is evaluated is the exponential moving average
            over about this many updates; 1 = the last one.
        critic_steps: agent steps at the start in which only the critic learns, rounded
            up to updates; for warm starts from a policy without a critic.
        curriculum: settings of training that evaluations do not have.
        networks: layers of actor and critic.
        env: the environment.
    """

    warm_start: str = ""
    lot_life: Natural = 16
    stored_lots: Natural = 0
    unroll_length: Count = 64
    num_minibatches: Count = 16
    num_epochs: Count = 4
    learning_rate: Positive = data(1.5e-3)
    learning_rate_end: NonNegative = data(2e-4)
    entropy_cost: NonNegative = data(5e-3)
    entropy_cost_end: NonNegative = data(1e-3)
    clip: Positive = data(0.2)
    clip_end: NonNegative = data(0.2)
    discount: Ratio = data(0.99)
    gae_lambda: Ratio = data(0.92)
    max_grad_norm: Positive = 1.0
    half_precision: bool = False
    variant: str = BRAX
    averaged_updates: Count = 32
    critic_steps: int = 0
    curriculum: CurriculumConfig = dataclasses.field(default_factory=CurriculumConfig)
    networks: NetworkConfig = dataclasses.field(default_factory=NetworkConfig)
    env: EnvConfig = dataclasses.field(default_factory=EnvConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Updates are counted in int32.
        most = LARGEST_WHOLE * self.steps_per_update
        for name, least in (("num_steps", 1), ("critic_steps", 0)):
            if not least <= (value := getattr(self, name)) <= most:
                raise ValueError(f"{name} must lie in [{least}, {most}], not {value}")
        if self.discount == 1.0 and self.curriculum.discount_end:
            raise ValueError("discount must be below 1 with curriculum.discount_end")
        if not self.env.episode.respawn:
            raise ValueError("PPO needs env.episode.respawn = True")
        if self.half_precision and self.networks.encoder != "set":
            raise ValueError("half_precision needs networks.encoder 'set'")
        if self.variant != BRAX:  # it is made for all settings, and takes a second
            VARIANTS[self.variant].check(self)
        if self.critic_steps and self.critic_updates >= self.num_updates:
            raise ValueError(
                f"critic_steps must leave the actor an update of num_steps "
                f"{self.num_steps}, not be {self.critic_steps}"
            )
        agents = self.num_lots * self.env.num_agents
        if agents % self.num_minibatches:
            raise ValueError(
                f"num_lots x num_agents = {agents} must be a multiple of "
                f"num_minibatches {self.num_minibatches}"
            )

    @property
    def steps_per_update(self) -> int:
        """Agent steps expected of one update, those of present agents.

        What a training reports is counted, not expected.
        """
        return round(self.present_share * self.slots_per_update)

    @property
    def slots_per_update(self) -> int:
        """Steps simulated for one update, those of absent agents included."""
        return self.num_lots * self.env.num_agents * self.unroll_length

    @property
    def present_share(self) -> float:
        """Share of the agents that are present if all their numbers are as likely."""
        counts = self.env.agent_counts
        return (counts[0] + counts[-1]) / (2 * self.env.num_agents)

    @property
    def critic_updates(self) -> int:
        """Updates in which only the critic learns."""
        return -(-self.critic_steps // self.steps_per_update)

    @property
    def num_updates(self) -> int:
        """Updates in all; the last may overshoot `num_steps`."""
        return -(-self.num_steps // self.steps_per_update)

    def progress(
        self, update: jax.Array | int, seconds: jax.Array | float
    ) -> jax.Array:
        """Share of the training that is done, in [0, 1].

        Args:
            update: updates made.
            seconds: time since the first update [s]; it counts if `minutes` limits it.
        """
        by_steps = jnp.asarray(update / self.num_updates)
        if not self.minutes:
            return by_steps
        by_time = seconds / (60.0 * self.minutes)
        return jnp.minimum(jnp.maximum(by_steps, by_time), 1.0)

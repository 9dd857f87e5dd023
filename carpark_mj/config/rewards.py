"""Weights of the reward terms, and sets of them by name."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

from carpark_mj.config.checks import CheckedConfig, NonNegative
from carpark_mj.config.goals import GoalRewards
from carpark_mj.config.insertion import data
from carpark_mj.config.reward_terms import ExtraTerms, check_extra
from carpark_mj.extensions import Registry

if TYPE_CHECKING:
    Extra = Mapping[str, float]
else:
    Extra = ExtraTerms


@dataclasses.dataclass(frozen=True)
class RewardConfig(CheckedConfig):
    """Weights of the reward terms.

    All weights are non-negative, and 0 disables a term. Each says whether its term is a
    reward (added) or a penalty (subtracted). "Per step" weights are divided by
    `EpisodeConfig.max_steps`, so that they add up to the weight over a full episode.

    Attributes:
        park: reward for parking, once.
        crash: penalty for crashing, once.
        time: penalty per step.
        progress: reward per metre gained towards the goal; negative when moving away.
        route: measure the distances of `progress` and `alignment` along the lanes
            (`carpark_mj.layouts.routes`) instead of straight; fixed goals only.
        reeds_shepp_reach: distance to the goal [m] within which `progress` measures the
            shortest Reeds-Shepp path instead, nose in or nose out: that of a car with
            the own turning circle, gear changes included. It is mixed in linearly down
            to a quarter of this distance. 0 = never.
        alignment: reward per radian of misalignment with the goal's axis removed,
            fading with the distance to the goal; negative when it grows.
        closeness: penalty per step, times the share of 3 m by which the nearest other
            agent is too close.
        extra: weights of terms in `REWARD_TERMS` by name, as in `{"haste": 0.01}`, and
            their parameters, as in `{"haste": 0.01, "haste.above": 2.0}`.
        goals: signed rewards for choosing and losing goals; dynamic goals only.
    """

    park: NonNegative = data(4.0)
    crash: NonNegative = data(2.5)
    time: NonNegative = data(1.0)
    progress: NonNegative = data(0.2)
    route: bool = False
    reeds_shepp_reach: NonNegative = data(0.0)
    alignment: NonNegative = data(0.5)
    closeness: NonNegative = data(15.0)
    extra: Extra = dataclasses.field(default_factory=ExtraTerms)
    goals: GoalRewards = dataclasses.field(default_factory=GoalRewards)

    def __post_init__(self) -> None:
        if isinstance(self.extra, Mapping):  # pyright: ignore[reportUnnecessaryIsInstance]
            object.__setattr__(self, "extra", ExtraTerms(self.extra))
        super().__post_init__()
        own = {field.name for field in dataclasses.fields(self)}
        goals = {field.name for field in dataclasses.fields(self.goals)}
        check_extra(self.extra, own | goals | {"lost_goal", "bad_goal"})

    def parameters(self, name: str) -> dict[str, float]:
        """Parameters of a term that `extra` gives other values than the defaults."""
        start = f"{name}."
        return {
            key.removeprefix(start): value
            for key, value in self.extra.items()
            if key.startswith(start)
        }


REWARDS: Registry[RewardConfig] = Registry("reward", "carpark_mj.tasks.goal_pose")
REWARDS.register("shaped", RewardConfig())

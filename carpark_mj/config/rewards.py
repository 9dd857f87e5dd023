"""Weights of the reward terms, and sets of them by name."""

import dataclasses
from typing import Literal

from carpark_mj.config.checks import (
    CheckedConfig,
    require_at_least,
    require_choice,
    require_positive,
)
from carpark_mj.config.goals import GoalRewards

RewardName = Literal["shaped", "tanner"]


@dataclasses.dataclass(frozen=True)
class RewardConfig(CheckedConfig):
    """Weights of the terms of `carpark_mj.mdp.rewards`.

    All weights are non-negative, and 0 disables a term. Each says whether its term is a
    reward (added) or a penalty (subtracted). "Per step" weights are divided by
    `EpisodeConfig.max_steps`, so that they add up to the weight over a full episode.

    Attributes:
        park: reward for parking, once.
        final_speed: penalty on parking, times the speed as a share of the top speed.
        final_heading: penalty on parking, times the misalignment with the bay's axis,
            either way round: 0 = along it, 1 = across it.
        crash: penalty for crashing, once.
        timeout: penalty for timing out, once.
        time: penalty per step.
        progress: reward per metre gained towards the goal; negative when moving away.
        route: measure the distances of `progress` and `alignment` along the lanes
            (`carpark_mj.layouts.routes`) instead of straight; fixed goals only.
        reeds_shepp: distance to the goal within which the way to go becomes the
            shortest one of a car that steers so far and no farther, gear changes
            included, nose in or nose out [m]; it is mixed in linearly down to a quarter
            of this distance. 0 = never.
        alignment: reward per radian of misalignment with the goal's axis removed,
            fading with the distance to the goal; negative when it grows.
        alignment_range: distance at which the alignment reward has faded to 1/e [m].
        approach: reward per step that ends nearer to the goal, penalty per step that
            does not (Tanner's "move towards goal").
        smoothness: penalty per step, times the steering change as a share of the
            largest; on the grid times the turn over the largest.
        smoothness_by_speed: multiply the smoothness penalty by the share of the top
            speed.
        reverse: penalty per step in reverse.
        wrong_way: penalty per step driven against the lanes
            (`carpark_mj.mdp.wrong_way`); no term in lots that never have lanes.
        closeness: penalty per step, times the share of `closeness_range` by which the
            nearest other agent is too close.
        closeness_range: clearance between agents below which they are too close [m].
        goals: signed rewards for choosing and losing goals; dynamic goals only.
    """

    park: float = 4.0
    final_speed: float = 0.0
    final_heading: float = 0.0
    crash: float = 2.5
    timeout: float = 0.0
    time: float = 1.0
    progress: float = 0.2
    route: bool = False
    reeds_shepp: float = 0.0
    alignment: float = 0.5
    alignment_range: float = 4.0
    approach: float = 0.0
    smoothness: float = 0.0
    smoothness_by_speed: bool = False
    reverse: float = 0.0
    wrong_way: float = 0.0
    closeness: float = 15.0
    closeness_range: float = 3.0
    goals: GoalRewards = dataclasses.field(default_factory=GoalRewards)

    def __post_init__(self) -> None:
        super().__post_init__()
        other = ("goals", "route", "smoothness_by_speed")
        names = [f.name for f in dataclasses.fields(self) if f.name not in other]
        require_at_least(self, 0.0, *names)
        require_positive(self, "alignment_range", "closeness_range")


REWARDS: dict[str, RewardConfig] = {
    "shaped": RewardConfig(),
    # Table C.9 of Tanner 2022; potential-based terms off.
    "tanner": RewardConfig(
        park=1.0,
        crash=1.0,
        time=0.2,
        progress=0.0,
        alignment=0.0,
        approach=0.15,
        smoothness=0.05,
        reverse=0.1,
        closeness=0.0,
    ),
}


def reward_preset(name: str) -> RewardConfig:
    """Looks a named reward set up.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    require_choice("reward", name, RewardName)
    return REWARDS[name]

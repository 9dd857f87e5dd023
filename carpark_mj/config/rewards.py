"""Weights of the reward terms, and sets of them by name."""

import dataclasses
from typing import Literal

from carpark_mj.config.checks import at_least, choose, positive
from carpark_mj.config.goals import GoalRewards

RewardName = Literal["shaped", "tanner"]


@dataclasses.dataclass(frozen=True)
class RewardConfig:
    """Weights of the terms of `carpark_mj.mdp.rewards`; a weight of 0 drops a term.

    Attributes:
        park: paid once when the agent parks.
        final_speed: taken from it, times the share of the top speed still driven.
        final_heading: taken from it, times the misalignment with the bay's axis either
            way round: 0 along it, 1 across it.
        crash: taken once when it crashes.
        timeout: taken once when it times out.
        time: taken over a whole episode of `max_steps`, a share each step.
        progress: per metre gained towards the goal.
        alignment: per radian of misalignment with the goal's axis removed, fading
            with the distance to the goal.
        alignment_range: distance at which the alignment term has faded to 1/e [m].
        approach: over a whole episode, for each step that ends nearer to the goal;
            taken when it does not (Tanner's "move towards goal").
        smoothness: taken over a whole episode, times the steering change used; on the
            grid times the turn, of which there is none while standing.
        smoothness_by_speed: whether that counts times the share of the top speed.
        reverse: taken over a whole episode, for each step in reverse.
        wrong_way: taken over a whole episode, for each step driven against the lanes
            (`carpark_mj.mdp.wrong_way`); no term in lots that never have lanes.
        closeness: taken over a whole episode, for each step times the share of
            `closeness_range` by which the nearest other agent is too close.
        closeness_range: clearance between agents at which closeness begins [m].
        goals: paid for what becomes of dynamic goals.
    """

    park: float = 4.0
    final_speed: float = 0.0
    final_heading: float = 0.0
    crash: float = 2.5
    timeout: float = 0.0
    time: float = 1.0
    progress: float = 0.2
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
        names = [f.name for f in dataclasses.fields(self) if f.name != "goals"]
        at_least(self, 0.0, *names)
        positive(self, "alignment_range", "closeness_range")


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
    choose("reward", name, RewardName)
    return REWARDS[name]

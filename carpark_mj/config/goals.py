"""Who chooses the goals: the environment, or the agents themselves."""

import dataclasses

from carpark_mj.config.checks import at_least


@dataclasses.dataclass(frozen=True)
class GoalConfig:
    """How agents come to their goals.

    Attributes:
        dynamic: every agent chooses its goal itself, at every step, among the free
            bays it tracks; otherwise the environment draws one for each episode.
        num_spaces: nearest free bays that an agent tracks (n_space).
    """

    dynamic: bool = False
    num_spaces: int = 1

    def __post_init__(self) -> None:
        at_least(self, 1, "num_spaces")

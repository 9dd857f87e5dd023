"""Who chooses the goals, the environment or the agents, and what choosing is worth."""

import dataclasses

from carpark_mj.config.checks import CheckedConfig, Count, Finite
from carpark_mj.config.insertion import data

TOLERANCE = 1e-9  # by which (3.5) may fail, for 0.1 + 0.2 is not 0.3


@dataclasses.dataclass(frozen=True)
class GoalConfig(CheckedConfig):
    """How agents get their goals.

    Attributes:
        dynamic: every agent chooses its goal at every step among the free bays it
            tracks; otherwise the environment draws one for each episode.
        num_tracked_bays: nearest free bays that an agent tracks (n_space).
        slots_by_distance: renumber the tracked bays at every step, the nearest first;
            otherwise a bay keeps its slot while it is tracked.
        may_repeat: whether the goal of an episode may be that of the one before; fixed
            goals only.
        drive_out: an agent that starts in a bay drives to an exit of the lot, all
            others to bays; fixed goals only, in layouts with exits.
    """

    dynamic: bool = False
    num_tracked_bays: Count = 1
    slots_by_distance: bool = False
    may_repeat: bool = False
    drive_out: bool = False


@dataclasses.dataclass(frozen=True)
class GoalRewards(CheckedConfig):
    """Rewards for what agents do with dynamic goals.

    They are signed rewards of a step, not divided by the episode length. The defaults
    are those of Tanner 2022, table C.10 (e is exploring, p and p' are bays).

    Attributes:
        continue_explore: reward for continuing to explore, r(e->e).
        stop_explore: reward for choosing a bay while exploring, r(e->p).
        continue_goal: reward for keeping the bay, r(p->p).
        change_goal: reward for choosing another bay, r(p->p').
        stop_goal: reward for giving up the bay to explore, r(p->e); None = r(p->p') -
            r(e->p), as the study's rule (3.5) requires. Losing the goal because it is
            no longer tracked pays the same, as in the reference implementation.
    """

    continue_explore: Finite = data(-0.002)
    stop_explore: Finite = data(0.0)
    continue_goal: Finite = data(0.0)
    change_goal: Finite = data(-0.05)
    stop_goal: Finite | None = data(None)

    @property
    def stop(self) -> float:
        """r(p->e), given or computed."""
        if self.stop_goal is None:
            return self.change_goal - self.stop_explore
        return self.stop_goal

    def check(self) -> None:
        """Refuses rewards for exploring for ever or changing goals by a detour.

        The study asks for a negative `change_goal`, but publishes a run with 0.

        Raises:
            ValueError: (3.5), and with it (3.6), or a sign is violated.
        """
        if self.continue_explore >= 0.0:
            raise ValueError(
                "reward.goals.continue_explore must be negative with dynamic goals, "
                f"not {self.continue_explore}"
            )
        if self.change_goal > 0.0:
            raise ValueError(
                "reward.goals.change_goal must be at most 0 with dynamic goals, not "
                f"{self.change_goal}"
            )
        if abs(self.stop + self.stop_explore - self.change_goal) > TOLERANCE:
            raise ValueError(
                "reward.goals must have change_goal = stop_goal + stop_explore, not "
                f"{self.change_goal} = {self.stop} + {self.stop_explore}"
            )

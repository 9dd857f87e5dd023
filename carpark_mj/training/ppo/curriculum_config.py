"""Settings of the curricula: what training does that evaluation never does."""

import dataclasses
from typing import Annotated

from carpark_mj.config.checks import Bounds, CheckedConfig, NonNegative, Ratio


@dataclasses.dataclass(frozen=True)
class CurriculumConfig(CheckedConfig):
    """Curricula of a PPO training, all off by default.

    Progress is the share of the training that is over.

    Attributes:
        crash_scale: factor on the crash penalty, and on that of the term `person`, that
            is reached, linearly from 1, at progress `crash_until`. A hard penalty from
            the start teaches halting.
        crash_until: progress at which the crash penalty has its full size.
        discount_end: discount factor at the end; 0 = that of the start. From progress
            0.3 to 0.8 the horizon, 1 / (1 - discount), changes linearly.
        conflict_ratio: share of spawns in conflict with another agent; 0 = as in the
            environment.
        reverse_ratio: share of spawns where a car has got to that drove out of the goal
            bay; 0 = as in the environment.
        misaligned_ratio: share of spawns in the goal bay, over its lines by
            centimetres or askew; 0 = as in the environment.
        target_rate: rate of parked episodes by whose shortfall half of a mixture's new
            lots are drawn (`lot_life`), and their numbers of agents with them; 0 = all
            are drawn as the mixture says.
        neighbour_share: weight, at the end, of the mean advantage of the other agents
            within 15 m, which is added to an agent's own. From progress 0.2 to 0.6 it
            rises linearly from 0: agents begin selfish.
        teacher: policy whose actions are imitated where the agents get to, as a name, a
            run or a checkpoint; "" = none. It observes what it was trained on.
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

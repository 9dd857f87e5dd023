"""Starts of episodes."""

import dataclasses
import math
from typing import Literal

from carpark_mj.config.checks import (
    CheckedConfig,
    Count,
    Natural,
    NonNegative,
    Ratio,
)

RelocationRule = Literal["furthest", "random", "any"]


@dataclasses.dataclass(frozen=True)
class SpawnConfig(CheckedConfig):
    """Where agents start an episode, and which parked car moves when one has parked.

    Attributes:
        close_ratio: share of spawns next to the goal.
        close_distance: longest walk of a close spawn from the point nearest to the goal
            [m].
        conflict_ratio: share of spawns in conflict with another agent: on course for a
            collision with it, or with its goal where goals are dynamic.
        conflict_distance: on a collision course, shortest distance of the other agent
            to its goal, and from the meeting point to that goal [m].
        reverse_ratio: share of spawns on a collision-free path sampled backwards from
            the goal; a training aid.
        misaligned_ratio: share of spawns in the goal bay, over its lines by
            centimetres or askew; a training aid for parked rules that ask for the lines
            of the bay. All remaining spawns are random.
        min_distance: desired distance to other agents' centres [m]; 7.38 m is Tanner's
            13.125 world units.
        num_candidates: poses drawn per spawn. The first that keeps `min_distance` is
            taken, or the one with most room to the other agents if none does.
        max_redraws: further rounds of `num_candidates` random poses while none keeps
            `min_distance`.
        spacing: spacing of the grid of start positions [m], centred in a spawn region
            and including its edges; 0 = anywhere.
        relocation: which parked car moves into a bay where an agent has parked: the one
            `furthest` from all agents, a `random` one that no agent tracks, or `any`, a
            random one that agents may track.
        kinds_at_reset: with dynamic goals, whether the first starts in a lot are of all
            kinds; otherwise they are random. With fixed goals they are of all kinds.
    """

    close_ratio: Ratio = 0.2
    close_distance: NonNegative = 5.625
    conflict_ratio: Ratio = 0.0
    conflict_distance: NonNegative = 7.38
    reverse_ratio: Ratio = 0.0
    misaligned_ratio: Ratio = 0.0
    min_distance: NonNegative = 7.38
    num_candidates: Count = 16
    max_redraws: Natural = 0
    spacing: NonNegative = 0.0
    relocation: RelocationRule = "furthest"
    kinds_at_reset: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        names = ("close_ratio", "conflict_ratio", "reverse_ratio", "misaligned_ratio")
        ratios = [getattr(self, name) for name in names]
        if math.fsum(ratios) > 1.0:
            raise ValueError(
                f"{' + '.join(names)} must be at most 1, not "
                f"{' + '.join(map(str, ratios))}"
            )

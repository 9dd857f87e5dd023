"""Forgetting and transfer from phase to phase: the success matrix.

Backward and forward transfer are those of Lopez-Paz & Ranzato 2017, "Gradient Episodic
Memory for Continual Learning", section 2 (arXiv 1706.08840).
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from carpark_papers.pandita.sac.phases import Phase

Rows = Sequence[dict[str, Any]]


@dataclasses.dataclass(frozen=True)
class Transfer:
    """Means over tasks; the task of a phase is to park in its kinds of lots.

    Attributes:
        average: success after the last phase, over all tasks.
        backward: success after the last phase less that just after the task's own,
            over all tasks but the last; negative = forgetting. NaN of one phase.
        forward: success just before the task's own phase less that of the untrained
            policy, over all tasks but the first. NaN of one phase.
    """

    average: float
    backward: float
    forward: float


def success_matrix(
    rows: Rows, kinds: Sequence[str], policy: str = "deterministic"
) -> np.ndarray:
    """Success rates (phases + 1, kinds), row 0 of the untrained policy; else NaN."""
    found = {
        (row["phase"], row["kind"]): row["success"]
        for row in rows
        if row["policy"] == policy
    }
    phases = int(max((row["phase"] for row in rows), default=0)) + 1
    return np.array(
        [
            [found.get((phase, kind), math.nan) for kind in kinds]
            for phase in range(phases)
        ]
    )


def transfer(
    matrix: np.ndarray, kinds: Sequence[str], phases: Sequence[Phase]
) -> Transfer:
    """Average, backward and forward transfer of a success matrix.

    Args:
        matrix: of `success_matrix`, with a row for each phase and for none.
        kinds: its columns.
        phases: of the training.
    """
    number = {kind: column for column, kind in enumerate(kinds)}
    tasks = [[number[kind] for kind in phase.kinds] for phase in phases]
    success = np.stack([matrix[:, task].mean(axis=1) for task in tasks], axis=1)
    last = len(phases)
    backward = [success[last, k] - success[k + 1, k] for k in range(last - 1)]
    forward = [success[k, k] - success[0, k] for k in range(1, last)]
    mean = [float(np.mean(part)) if part else math.nan for part in (backward, forward)]
    return Transfer(float(success[last].mean()), *mean)

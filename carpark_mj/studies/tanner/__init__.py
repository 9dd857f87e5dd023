"""Tanner 2022: parking agents that learn to share a lot."""

from carpark_mj.programs import STUDY_PROGRAMS, Program
from carpark_mj.studies.tanner import rewards

__all__ = ["rewards"]

STUDY_PROGRAMS.register(
    "q_learning",
    Program(
        "carpark_mj.studies.tanner.q_learning.program:run",
        "tabular Q-learning on the grid, Tanner 2022",
    ),
)
STUDY_PROGRAMS.register(
    "tanner",
    Program(
        "carpark_mj.studies.tanner.experiments.program:run",
        "the figures of Tanner 2022",
    ),
)

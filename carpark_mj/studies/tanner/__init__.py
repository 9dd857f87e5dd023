"""Tanner 2022 (arXiv 2206.13338): agents on a grid around a square."""

from carpark_mj.programs import STUDY_PROGRAMS, Program
from carpark_mj.studies.tanner import layouts, vehicles

# isort: split
from carpark_mj.studies.tanner import environments  # of what is named above

__all__ = ["environments", "layouts", "vehicles"]

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

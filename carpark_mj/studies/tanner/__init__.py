"""Tanner 2022: parking agents that learn to share a lot (arXiv 2206.13338)."""

from carpark_mj.config.observations import ENCODERS
from carpark_mj.programs import STUDY_PROGRAMS, Program
from carpark_mj.studies.tanner.indices import IndexObservation
from carpark_mj.studies.tanner.observation import TannerObservation

ENCODERS.register("tanner", TannerObservation)
ENCODERS.register("indices", IndexObservation)
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

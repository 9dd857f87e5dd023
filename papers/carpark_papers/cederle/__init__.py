"""Cederle 2023: automated cars that cross a junction."""

from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS

STUDY_PROGRAMS.register(
    "junction",
    Entry(
        "carpark_papers.cederle.training.program:run",
        "cars that cross a junction, Cederle 2023",
    ),
)
STUDY_PROGRAMS.register(
    "junction_tables",
    Entry(
        "carpark_papers.cederle.experiments.program:run", "the tables of Cederle 2023"
    ),
)
STUDY_PROGRAMS.register(
    "junction_scene",
    Entry("carpark_papers.cederle.scene:run", "the junction as MJCF, or in a viewer"),
)
STUDY_PROGRAMS.register(
    "junction_speed",
    Entry("carpark_papers.cederle.speed:run", "agent steps/s at the junction"),
)

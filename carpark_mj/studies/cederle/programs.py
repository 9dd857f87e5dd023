"""The programs of the study, by name."""

from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS

STUDY_PROGRAMS.register(
    "junction",
    Entry(
        "carpark_mj.studies.cederle.training.program:run",
        "cars that cross a junction, Cederle 2023",
    ),
)
STUDY_PROGRAMS.register(
    "junction_tables",
    Entry(
        "carpark_mj.studies.cederle.experiments.program:run",
        "the tables of Cederle 2023",
    ),
)
STUDY_PROGRAMS.register(
    "junction_scene",
    Entry(
        "carpark_mj.studies.cederle.scene:run", "the junction as MJCF, or in a viewer"
    ),
)
STUDY_PROGRAMS.register(
    "junction_speed",
    Entry("carpark_mj.studies.cederle.speed:run", "agent steps/s at the junction"),
)

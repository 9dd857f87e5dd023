"""Cederle 2023: automated cars that cross a junction."""

from carpark_mj.programs import STUDY_PROGRAMS, Program

STUDY_PROGRAMS.register(
    "junction",
    Program(
        "carpark_mj.studies.cederle.training.program:run",
        "cars that cross a junction, Cederle 2023",
    ),
)
STUDY_PROGRAMS.register(
    "junction_tables",
    Program(
        "carpark_mj.studies.cederle.experiments.program:run",
        "the tables of Cederle 2023",
    ),
)

"""Pandita 2022: parking in slots with SAC and hindsight replay."""

from carpark_mj.programs import STUDY_PROGRAMS, Program

STUDY_PROGRAMS.register(
    "sac",
    Program(
        "carpark_mj.studies.pandita.sac.program:run",
        "SAC and hindsight replay in slots, Pandita 2022",
    ),
)
STUDY_PROGRAMS.register(
    "slots",
    Program(
        "carpark_mj.studies.pandita.experiments.program:run",
        "the experiments of Pandita 2022",
    ),
)

"""Pandita 2022: one car parks between two rows of slots."""

from carpark_mj.programs import STUDY_PROGRAMS, Program
from carpark_mj.studies.pandita import layouts, vehicles

# isort: split
from carpark_mj.studies.pandita import environments  # of what is named above

__all__ = ["environments", "layouts", "vehicles"]

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

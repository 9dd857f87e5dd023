"""The programs of the study, by name."""

from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS

STUDY_PROGRAMS.register(
    "sac",
    Entry(
        "carpark_papers.pandita.sac.program:run",
        "SAC and hindsight replay in slots, Pandita 2022",
    ),
)
STUDY_PROGRAMS.register(
    "slots",
    Entry(
        "carpark_papers.pandita.experiments.program:run",
        "the experiments of Pandita 2022",
    ),
)

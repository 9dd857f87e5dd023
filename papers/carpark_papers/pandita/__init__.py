"""Pandita 2022: one car parks between two rows of slots."""

from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS
from carpark_papers.pandita import layouts, task

__all__ = ["layouts", "task"]

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

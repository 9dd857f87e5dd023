"""Papers reproduced with carpark_mj, and the Gymnasium id of one of them."""

from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS
from carpark_mj.registration import add_environment

add_environment(
    "carpark_mj/Slots-v0",
    "carpark_papers.pandita.slots_env:SlotsEnv",
    "carpark_papers.pandita.slots_env:SlotsVectorEnv",
)
# Here, so that their list needs none of the papers' modules.
for _name, (_home, _summary) in {
    "q_learning": (
        "tanner.q_learning.program",
        "tabular Q-learning on the grid, Tanner 2022",
    ),
    "tanner": ("tanner.experiments.program", "the figures of Tanner 2022"),
    "sac": ("pandita.sac.program", "SAC and hindsight replay in slots, Pandita 2022"),
    "slots": ("pandita.experiments.program", "the experiments of Pandita 2022"),
    "junction": (
        "cederle.training.program",
        "cars that cross a junction, Cederle 2023",
    ),
    "junction_tables": ("cederle.experiments.program", "the tables of Cederle 2023"),
    "junction_scene": ("cederle.scene", "the junction as MJCF, or in a viewer"),
    "junction_speed": ("cederle.speed", "agent steps/s at the junction"),
}.items():
    STUDY_PROGRAMS.register(_name, Entry(f"carpark_papers.{_home}:run", _summary))

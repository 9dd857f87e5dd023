"""Papers reproduced with carpark_mj, and the Gymnasium id of one of them."""

from carpark_mj.registration import add_environment

add_environment(
    "carpark_mj/Slots-v0",
    "carpark_papers.pandita.slots_env:SlotsEnv",
    "carpark_papers.pandita.slots_env:SlotsVectorEnv",
)

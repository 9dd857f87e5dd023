"""Gymnasium's ids of our environments; imports neither JAX nor MuJoCo."""

from typing import Any, NoReturn

from gymnasium.envs.registration import register, registry
from gymnasium.error import Error

_ROOM = "carpark_mj.wrappers"
# Entry points of one environment and of many by id.
ENTRY_POINTS: dict[str, tuple[str, str]] = {
    "carpark_mj/Park-v0": (
        f"{_ROOM}.gymnasium_env:ParkEnv",
        f"{_ROOM}.gymnasium_vector:ParkVectorEnv",
    ),
    "carpark_mj/ParkGoal-v0": (
        f"{_ROOM}.gymnasium_goal:ParkGoalEnv",
        f"{_ROOM}.gymnasium_vector:ParkGoalVectorEnv",
    ),
    "carpark_mj/Slots-v0": (
        f"{_ROOM}.gymnasium_slots:SlotsEnv",
        f"{_ROOM}.gymnasium_slots:SlotsVectorEnv",
    ),
    "carpark_mj/ParkMany-v0": (
        "carpark_mj.registration:refuse_single",
        f"{_ROOM}.gymnasium_vector:ParkManyVectorEnv",
    ),
}


def refuse_single(**_: Any) -> NoReturn:
    """There is no single ParkMany: its environments are agents that share lots.

    Raises:
        gymnasium.error.Error: always.
    """
    raise Error(
        "carpark_mj/ParkMany-v0 has no single environment, as its agents share lots: "
        'use gymnasium.make_vec("carpark_mj/ParkMany-v0", num_envs)'
    )


def register_environments() -> None:
    """Registers the ids, if that has not been done."""
    for name, (single, vector) in ENTRY_POINTS.items():
        if name not in registry:
            register(name, single, vector_entry_point=vector)

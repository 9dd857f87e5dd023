"""Gymnasium's ids of our environments, registered once Gymnasium is imported.

Gymnasium 1 has no entry points for ids, and takes ten times as long to import as this.
"""

import importlib.util
import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, NoReturn

_PARK, _GOAL = "carpark_mj.wrappers.gymnasium_env", "carpark_mj.wrappers.goal"
# Entry points of one environment and of many by id.
ENTRY_POINTS: dict[str, tuple[str, str]] = {
    "carpark_mj/Park-v0": (f"{_PARK}:ParkEnv", f"{_PARK}:ParkVectorEnv"),
    "carpark_mj/ParkGoal-v0": (f"{_GOAL}:ParkGoalEnv", f"{_GOAL}:ParkGoalVectorEnv"),
    "carpark_mj/ParkMany-v0": (
        "carpark_mj.registration:refuse_single",
        f"{_PARK}:ParkManyVectorEnv",
    ),
    "carpark_mj/FirstPark-v0": (f"{_PARK}:ParkEnv", f"{_PARK}:ParkVectorEnv"),
}
OPTIONS = {"carpark_mj/FirstPark-v0": {"config": "first"}}  # of ids that have any


def refuse_single(**_: Any) -> NoReturn:
    """There is no single ParkMany: its environments are agents that share lots."""
    from gymnasium.error import Error

    raise Error(
        "carpark_mj/ParkMany-v0 has no single environment, as its agents share lots: "
        'use gymnasium.make_vec("carpark_mj/ParkMany-v0", num_envs)'
    )


def add_environment(name: str, single: str, vector: str) -> None:
    """Adds an id of another package, which Gymnasium knows from its import on.

    `single` is the entry point of one environment, `module:class`, `vector` of many.
    """
    ENTRY_POINTS[name] = single, vector
    if "gymnasium" in sys.modules:
        register_environments()


def register_environments() -> None:
    """Registers the ids that are not registered: now, or when Gymnasium is imported."""
    if "gymnasium" not in sys.modules:
        sys.meta_path.insert(0, _BesideGymnasium())
        return
    from gymnasium.envs.registration import register, registry

    for name, (single, vector) in ENTRY_POINTS.items():
        if name not in registry:
            given = OPTIONS.get(name)
            register(name, single, kwargs=given, vector_entry_point=vector)


class _BesideGymnasium:
    """Finds Gymnasium as the others do; once it is loaded the ids are registered."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        """The spec of Gymnasium, with what follows its loading."""
        del path, target
        if fullname != "gymnasium":
            return None
        sys.meta_path.remove(self)
        try:
            spec = importlib.util.find_spec(fullname)
        finally:
            sys.meta_path.insert(0, self)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_register(module: ModuleType) -> None:
            load(module)
            sys.meta_path.remove(self)
            register_environments()

        spec.loader.exec_module = load_and_register
        return spec

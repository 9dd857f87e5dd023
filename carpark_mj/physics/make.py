"""Builds the back end of an environment, and refuses objects that are none."""

from typing import Any

from carpark_mj.config import EnvConfig, PhysicsConfig
from carpark_mj.layouts import Layout
from carpark_mj.physics.base import Physics, PhysicsState
from carpark_mj.vehicle import VehicleParameters

MEMBERS = (
    "config",
    "init",
    "step",
    "place",
    "set_parked_poses",
    "parked_poses",
    "read",
)


def make_physics(
    config: EnvConfig, layout: Layout | None, vehicle: VehicleParameters
) -> Physics[PhysicsState]:
    """Builds the back end of an environment.

    Args:
        config: the environment.
        layout: its lot; None if that is random.
        vehicle: of all cars, for `scene`.

    Raises:
        ValueError: the back end cannot do what else is configured.
        TypeError: what its config makes is no back end.
    """
    return require_physics(config.physics_config.make(config, layout, vehicle))


def require_physics(physics: Any) -> Physics[PhysicsState]:
    """Refuses an object that is no back end.

    Raises:
        TypeError: naming what it lacks.
    """
    if isinstance(physics, str):
        raise TypeError(
            f"physics must be of Physics or None, not {physics!r}: a name stands in "
            "the config"
        )
    if missing := [name for name in MEMBERS if not hasattr(physics, name)]:
        raise TypeError(
            f"physics {type(physics).__name__} lacks {', '.join(missing)} of a back "
            "end, carpark_mj.physics.base.Physics"
        )
    if not isinstance(physics.config, PhysicsConfig):
        raise TypeError(
            f"config of physics {type(physics).__name__} must be a PhysicsConfig, not "
            f"{physics.config!r}"
        )
    return physics

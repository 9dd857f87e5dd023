"""Builds the back end that a configuration names.

`contact` and `scene` are imported when they are asked for: they import MJX and trimesh,
which together take about half of the time to import the environment.
"""

from carpark_mj.config import EnvConfig
from carpark_mj.layouts import Layout
from carpark_mj.physics.base import Physics, PhysicsState, erase_state
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.grid import GridPhysics
from carpark_mj.physics.highway import HighwayPhysics
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import VehicleParameters


def make_physics(
    config: EnvConfig, layout: Layout | None, vehicle: VehicleParameters
) -> Physics[PhysicsState]:
    """Builds the back end of an environment.

    Args:
        config: the environment.
        layout: its lot; None if that is random.
        vehicle: of all cars, for `scene`.

    Raises:
        ValueError: `scene` physics cannot do what else is configured.
    """
    contact = config.sim.tyres == "contact"
    if config.physics == "grid":
        return erase_state(GridPhysics(config.grid, config.sim))
    if config.physics == "bicycle":
        return erase_state(BicyclePhysics(config.sim))
    if config.physics == "highway":
        return erase_state(HighwayPhysics(config.sim))
    if config.physics == "mjx":
        if not contact:
            return erase_state(MjxPhysics(config.sim))
        from carpark_mj.physics.contact import ContactPhysics

        return erase_state(ContactPhysics(config.sim))
    if contact:
        raise ValueError("scene physics has brush tyres only, not contact")
    if layout is None:
        raise ValueError(
            f"scene physics needs the same lot for every key, not {config.layout!r}"
        )
    if config.fleet.is_on or config.jitter.scale != (1.0, 1.0):
        raise ValueError(
            "scene physics has cars of one kind and size only, no fleet and no "
            "jitter.scale: use mjx"
        )
    from carpark_mj.physics.scene import ScenePhysics

    return erase_state(
        ScenePhysics(
            config.sim, layout, vehicle, config.num_agents, config.num_parked_cars
        )
    )

"""The core's back ends; their modules are imported when they are built.

`contact` imports MJX and `scene` trimesh, together about half of the import time of the
environment.
"""

import dataclasses
from typing import TYPE_CHECKING, Any

from carpark_mj.config import PHYSICS, EnvConfig, PhysicsConfig
from carpark_mj.config.obstacles import make_movers

if TYPE_CHECKING:
    from carpark_mj.layouts import Layout
    from carpark_mj.physics.base import Physics
    from carpark_mj.vehicle import VehicleParameters


@dataclasses.dataclass(frozen=True)
class MjxConfig(PhysicsConfig):
    """Rigid-body cars on tyres, each simulated on its own."""

    back_end: str = "mjx"

    def check(self, config: EnvConfig) -> None:
        """Refuses substeps too long for the tyres."""
        config.sim.require_fine_steps()

    def make(
        self, config: EnvConfig, layout: "Layout | None", vehicle: "VehicleParameters"
    ) -> "Physics[Any]":
        """Builds it with the tyres of `SimConfig.tyres`."""
        del layout, vehicle
        if config.sim.tyres == "contact":
            from carpark_mj.physics.contact import ContactPhysics

            return ContactPhysics(config.sim)
        from carpark_mj.physics.mjx import MjxPhysics

        return MjxPhysics(config.sim)


@dataclasses.dataclass(frozen=True)
class SceneConfig(PhysicsConfig):
    """The whole lot in one C MuJoCo world."""

    back_end: str = "scene"
    contacts = True

    def check(self, config: EnvConfig) -> None:
        """Refuses long substeps, contact tyres, and cars of several kinds or sizes."""
        config.sim.require_fine_steps()
        if config.sim.tyres == "contact":
            raise ValueError("scene physics has brush tyres only, not contact")
        if config.sim.has_ramp:
            raise ValueError(
                "scene physics has one gravity for the whole lot: sim.ramp must have "
                f"slope 0, not {config.sim.ramp[2]}; use mjx"
            )
        if config.sim.creep and not config.episode.respawn:
            raise ValueError(
                "scene physics goes on moving cars that have finished, which would "
                "creep away: sim.creep needs episode.respawn = True there"
            )
        if config.fleet.is_on or config.jitter.scale != (1.0, 1.0):
            raise ValueError(
                "scene physics has cars of one kind and size only, no fleet and no "
                "jitter.scale: use mjx"
            )

    def make(
        self, config: EnvConfig, layout: "Layout | None", vehicle: "VehicleParameters"
    ) -> "Physics[Any]":
        """Compiles the scene of the lot."""
        if layout is None:
            raise ValueError(
                f"scene physics needs the same lot for every key, not {config.layout!r}"
            )
        from carpark_mj.obstacles import mover_shapes
        from carpark_mj.physics.scene import ScenePhysics

        return ScenePhysics(
            config.sim,
            layout,
            vehicle,
            config.num_agents,
            config.num_parked_cars,
            mover_shapes(make_movers(config.movers), layout),
        )


@dataclasses.dataclass(frozen=True)
class BicycleConfig(PhysicsConfig):
    """Kinematic cars whose tyres never slip."""

    back_end: str = "bicycle"

    def make(
        self, config: EnvConfig, layout: "Layout | None", vehicle: "VehicleParameters"
    ) -> "Physics[Any]":
        """Builds it; its ground is a plane."""
        from carpark_mj.physics.bicycle import BicyclePhysics

        del layout, vehicle
        return BicyclePhysics(config.sim)


for _config in (MjxConfig(), SceneConfig(), BicycleConfig()):
    PHYSICS.register(_config.back_end, _config)

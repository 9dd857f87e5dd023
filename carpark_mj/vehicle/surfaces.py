"""Ground by name: how well tyres grip on it.

A car's tyre friction is that on dry asphalt; a surface scales it for every car alike.

Sources: dry, peak friction of passenger-car tyres on asphalt (Gillespie; sliding 0.76
+- 0.06, 17 studies in Bartlett); wet 0.5 to 0.6 and ice 0.1 to 0.15, textbook ranges.
"""

import dataclasses

import jax

from carpark_mj.config import Surface
from carpark_mj.vehicle.vehicle import Vehicle

SURFACES: dict[Surface, float] = {"dry": 0.9, "wet": 0.55, "ice": 0.12}


def on_surface(vehicle: Vehicle, surface: Surface) -> Vehicle:
    """Cars (...) with the grip they have on a surface; `dry` changes nothing."""
    if surface == "dry":
        return vehicle
    return with_grip(vehicle, SURFACES[surface] / SURFACES["dry"])


def with_grip(vehicle: Vehicle, factor: float | jax.Array) -> Vehicle:
    """Cars (...) whose tyre friction, scrub torque included, is scaled."""
    tyres = dataclasses.replace(
        vehicle.tyres,
        friction=vehicle.tyres.friction * factor,
        torsion_stiffness=vehicle.tyres.torsion_stiffness * factor,
    )
    return dataclasses.replace(vehicle, tyres=tyres)

"""Cars under other conditions: their load, and the ground they drive on."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.config import SimConfig, Surface
from carpark_mj.vehicle.mjcf import CHASSIS
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import Vehicle


def with_mass(vehicle: Vehicle, mass: jax.Array, cg: jax.Array) -> Vehicle:
    """One car whose chassis has another mass and centre of gravity.

    It models load: passengers, luggage, an empty tank.

    Wheels and knuckles do not change; the chassis' inertia about its own centre
    grows with its mass. Static tyre loads follow, so that the car rests at the same
    height (level control), and with them the stiffness of the tyres, which is
    proportional to load. The pedal's torques stay (`rated_mass`).

    Args:
        vehicle: one car.
        mass: () of the whole car [kg].
        cg: (3,) its centre of gravity in the body frame [m], between the axles.
    """
    before = vehicle.body_mass[CHASSIS]
    chassis = before + mass - vehicle.mass
    moment = before * vehicle.body_ipos[CHASSIS] + mass * cg - vehicle.mass * vehicle.cg
    axle_load = mass * GRAVITY / vehicle.wheelbase / 2
    front, rear = axle_load * cg[0], axle_load * (vehicle.wheelbase - cg[0])
    load = jnp.stack([front, front, rear, rear])
    ratio = load / vehicle.tyres.static_load
    tyres = dataclasses.replace(
        vehicle.tyres,
        static_load=load,
        longitudinal_stiffness=vehicle.tyres.longitudinal_stiffness * ratio,
        lateral_stiffness=vehicle.tyres.lateral_stiffness * ratio,
        torsion_stiffness=vehicle.tyres.torsion_stiffness * ratio,
    )
    return dataclasses.replace(
        vehicle,
        mass=mass,
        cg=cg,
        tyres=tyres,
        body_mass=vehicle.body_mass.at[CHASSIS].set(chassis),
        body_ipos=vehicle.body_ipos.at[CHASSIS].set(moment / chassis),
        body_inertia=vehicle.body_inertia.at[CHASSIS].multiply(chassis / before),
    )


# A car's tyre friction is that on dry asphalt; a surface scales it for every car alike.
# Dry: peak friction of passenger-car tyres on asphalt (Gillespie; sliding 0.76 +- 0.06,
# 17 studies in Bartlett); wet 0.5 to 0.6 and ice 0.1 to 0.15, textbook ranges.
SURFACES: dict[Surface, float] = {"dry": 0.9, "wet": 0.55, "ice": 0.12}


def in_conditions(vehicle: Vehicle, sim: SimConfig) -> Vehicle:
    """Cars (...) as the settings have them; the defaults change nothing."""
    vehicle = on_surface(vehicle, sim.surface)
    if sim.creep:
        creep = jnp.full_like(vehicle.mass, sim.creep)
        vehicle = dataclasses.replace(vehicle, creep=creep)
    return vehicle


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

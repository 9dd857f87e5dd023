"""Mass and centre of gravity of a loaded car: passengers, luggage, an empty tank."""

import dataclasses

import jax
import jax.numpy as jnp

from carpark_mj.vehicle.mjcf import CHASSIS
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import Vehicle


def with_mass(vehicle: Vehicle, mass: jax.Array, cg: jax.Array) -> Vehicle:
    """One car whose chassis has another mass and centre of gravity.

    Wheels and knuckles stay as they are; the chassis' inertia about its own centre
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

"""One wheel's share of a car's parameters, for code that computes one wheel."""

import dataclasses

import jax
from flax import struct

from carpark_mj.vehicle.mjcf import WHEELS
from carpark_mj.vehicle.vehicle import Tyres, Vehicle


@struct.dataclass
class Wheel:
    """Parameters of a wheel; all leaves have the leading shape of the cars.

    Attributes:
        hub: (x, y) of its centre in the body frame [m].
        radius: [m].
        inertia: about its axle [kg m^2].
        drive_share: of the drive torque.
        brake_share: of the brake torque.
        tyre: coefficients of its tyre.
    """

    hub: tuple[jax.Array, jax.Array]
    radius: jax.Array
    inertia: jax.Array
    drive_share: jax.Array
    brake_share: jax.Array
    tyre: Tyres


def wheels_of(vehicle: Vehicle) -> tuple[Wheel, ...]:
    """The wheels of cars (...), in the order of `mjcf.WHEELS`."""
    return tuple(_wheel(vehicle, i) for i in range(len(WHEELS)))


def _wheel(vehicle: Vehicle, i: int) -> Wheel:
    tyres = vehicle.tyres
    tyre = dataclasses.replace(
        tyres,
        static_load=tyres.static_load[..., i],
        longitudinal_stiffness=tyres.longitudinal_stiffness[..., i],
        lateral_stiffness=tyres.lateral_stiffness[..., i],
        torsion_stiffness=tyres.torsion_stiffness[..., i],
    )
    return Wheel(
        hub=(vehicle.hub[..., i, 0], vehicle.hub[..., i, 1]),
        radius=vehicle.wheel_radius,
        inertia=vehicle.wheel_inertia,
        drive_share=vehicle.drive_share[..., i],
        brake_share=vehicle.brake_share[..., i],
        tyre=tyre,
    )

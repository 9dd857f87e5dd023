"""Mass properties of the whole car, from the bodies of its MuJoCo model."""

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.physics.vectors import Symmetric, Vector, add, scale, subtract
from carpark_mj.vehicle.vehicle import Vehicle

# Bodies of the car's model, `mjcf.add_car`.
_CHASSIS, _KNUCKLES, _FRONT_WHEELS, _REAR_WHEELS = 1, (2, 4), (3, 5), (6, 7)


@struct.dataclass
class MassProperties:
    """Mass properties of cars (...).

    Attributes:
        mass: of the whole car [kg].
        com: common centre of mass, body frame [m].
        body_inertia: about it, of all parts that do not steer: chassis, the masses of
            the corners as points, rear wheels without their spin [kg m^2].
        corner_inertia: of each front corner, knuckle and wheel, about the wheel's
            (longitudinal, axle, vertical) axes, without the spin [kg m^2].
        spin_inertia: of each wheel about its axle [kg m^2].
    """

    mass: jax.Array
    com: Vector
    body_inertia: Symmetric
    corner_inertia: tuple[Vector, Vector]
    spin_inertia: tuple[jax.Array, ...]


def mass_properties(vehicle: Vehicle) -> MassProperties:
    """Mass properties of cars (...) from the masses of their MuJoCo bodies."""
    masses, inertias = vehicle.body_mass, vehicle.body_inertia

    def vector(a: jax.Array, body: int) -> Vector:
        return a[..., body, 0], a[..., body, 1], a[..., body, 2]

    points = [(masses[..., _CHASSIS], vector(vehicle.body_ipos, _CHASSIS))]
    for knuckle, wheel in zip(_KNUCKLES, _FRONT_WHEELS, strict=True):
        mass = masses[..., knuckle] + masses[..., wheel]
        points.append((mass, vector(vehicle.body_pos, knuckle)))
    points += [(masses[..., w], vector(vehicle.body_pos, w)) for w in _REAR_WHEELS]
    mass = sum((m for m, _ in points), jnp.zeros_like(points[0][0]))
    moment = scale(0.0, points[0][1])
    for m, at in points:
        moment = add(moment, scale(m, at))
    com = scale(1.0 / mass, moment)

    xx, yy, zz = vector(inertias, _CHASSIS)
    xy = xz = yz = jnp.zeros_like(xx)
    for wheel in _REAR_WHEELS:
        tilt_x, _, tilt_z = vector(inertias, wheel)
        xx, zz = xx + tilt_x, zz + tilt_z
    for m, at in points:
        x, y, z = subtract(at, com)
        xx, yy, zz = (
            xx + m * (y * y + z * z),
            yy + m * (x * x + z * z),
            zz + m * (x * x + y * y),
        )
        xy, xz, yz = xy - m * x * y, xz - m * x * z, yz - m * y * z

    def corner(knuckle: int, wheel: int) -> Vector:
        tilt_x, _, tilt_z = vector(inertias, wheel)
        along, across, vertical = vector(inertias, knuckle)
        return along + tilt_x, across, vertical + tilt_z

    left, right = zip(_KNUCKLES, _FRONT_WHEELS, strict=True)
    wheels = _FRONT_WHEELS + _REAR_WHEELS
    return MassProperties(
        mass=mass,
        com=com,
        body_inertia=(xx, yy, zz, xy, xz, yz),
        corner_inertia=(corner(*left), corner(*right)),
        spin_inertia=tuple(inertias[..., wheel, 1] for wheel in wheels),
    )

"""Suspension of contact wheels: one vertical slide joint per wheel.

Brush tyres stand on a spring and damper per corner, suspension and tyre in series.
Contact wheels are rigid; their suspension gives them the same rates
(`TyreParameters.vertical_stiffness` and `vertical_damping`), so that both cars heave,
pitch and roll alike. With the presets' rates k and c the ride frequency
sqrt(4 k / m) / 2 pi is 1.36 to 1.46 Hz and the damping ratio 4 c / (2 sqrt(4 k m))
about 0.35, within the 1 to 1.5 Hz and 0.2 to 0.4 of passenger cars (Gillespie,
Fundamentals of Vehicle Dynamics, ch. 5).

No anti-roll bar: a car rolls 7 to 9 deg/g, more than most, which have one. The slides
are square to the body, so that forces along the ground pitch and roll it in full: no
anti-dive, roll centre on the ground.
"""

from typing import TypeVar

import jax
import mujoco

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters

Number = TypeVar("Number", float, jax.Array)

TRAVEL = 0.10  # m, from rest to the stop in bump and in rebound [est]

# Of the tyres' contacts. A wheel on a slide is some nine times lighter to lift than the
# car; at the rigid car's 0.95 the contacts would be as much softer, sag 1 mm and creep
# on slopes. (1 - d) / d is a ninth here.
SOLIMP = (0.994, 0.994, 0.001)


def spring_reference(load: Number, unsprung_mass: Number, stiffness: Number) -> Number:
    """Where a corner's spring would rest without its load [m], below the wheel's place.

    Args:
        load: on the tyre at rest [N].
        unsprung_mass: wheel and knuckle, which the spring does not carry [kg].
        stiffness: of the spring [N/m].
    """
    return -(load - unsprung_mass * GRAVITY) / stiffness


def add_travel(
    body: mujoco.MjsBody,
    params: VehicleParameters,
    name: str,
    load: float,
    unsprung_mass: float,
) -> None:
    """Lets a wheel or knuckle, which has no joint yet, move up and down in the car.

    Args:
        body: what moves.
        params: the vehicle.
        name: of the joint; up is positive, zero at rest.
        load: on the tyre at rest [N].
        unsprung_mass: that moves with the joint [kg].
    """
    joint = body.add_joint(
        name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], limited=True
    )
    stiffness = params.tyre.vertical_stiffness
    joint.stiffness = [stiffness, 0, 0]
    joint.damping = [params.tyre.vertical_damping, 0, 0]
    joint.springref = spring_reference(load, unsprung_mass, stiffness)
    joint.range = [-TRAVEL, TRAVEL]

"""Disc brakes in any MuJoCo: a pad on each wheel, all pressed by one slider.

A pad slides along the axle in the wheel's carrier and rubs on a disc of the wheel: dry
friction, which stops a wheel and holds it but never turns it backwards, as a torque
shared between the wheels would. The contacts are explicit pairs; nothing else touches
pads or discs. A tendon presses the pads in the brakes' shares. With a suspension the
pads travel with their wheels: those in front in the knuckles, the others beside their
wheels, to whose travel they are tied.
"""

import math

import mujoco

from carpark_mj.vehicle.mjcf import STEERED, WHEELS, hub_positions, per_wheel
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters

# Full brake over the torque of the tyres' grip. The front axle, which has 0.68 of the
# brake but then bears up to 0.8 of the weight, locks from 1.18 on; the rest is for
# moments at which a hopping wheel bears more.
FULL_BRAKE = 1.5
LEVER = 0.15  # m, of the pad above the axle
DISC_RADIUS, DISC_THICKNESS = 0.25, 0.1  # m
PAD_RADIUS, PAD_GAP = 0.02, 5e-4  # m
PAD_FRICTION = 0.4  # organic pads on cast iron
PAD_MASS, PAD_INERTIA = 1e-3, 1e-6  # kg, kg m^2: negligible beside the car's
# Contacts are as stiff as what they hold is heavy: the pads' armature, which weighs
# nothing in the car, keeps full brake from pressing them through the discs.
PAD_ARMATURE = 100.0  # kg
PAD_STIFFNESS = 2e4  # N/m, lifts a pad off its disc
PAD_DAMPING = 2.0 * math.sqrt(PAD_STIFFNESS * PAD_ARMATURE)  # N s/m, critical
SOLREF = (0.02, 1.0)
# A pad creeps over its disc by the force it holds. A car on a slope of 20 % rolled by 1
# to 5 mm/s at MuJoCo's usual 0.95 and the contact's own time constant.
SOLREF_FRICTION, SOLIMP = (0.004, 1.0), (0.999, 0.999, 0.001, 0.5, 2.0)
CALIPER_ARMATURE = 1.0  # kg, of a pad's travel
SOLREF_TRAVEL, SOLIMP_TRAVEL = (0.004, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)


def full_brake_torque(params: VehicleParameters) -> float:
    """Brake torque of all wheels together at full brake [N m]."""
    grip = params.tyre.friction * params.mass * GRAVITY
    return FULL_BRAKE * grip * params.wheel_radius


def add_disc_brakes(
    spec: mujoco.MjSpec, params: VehicleParameters, prefix: str
) -> None:
    """Adds discs, pads and the actuator `brake` in [0, 1] to a car.

    Args:
        spec: the model with the car of `mjcf.add_car` in it.
        params: the vehicle.
        prefix: of the car's names.
    """
    name = f"{prefix}brake"
    tendon = spec.add_tendon(name=name)
    shares = per_wheel(params.front_brake)
    for wheel, hub, share in zip(WHEELS, hub_positions(params), shares, strict=True):
        steered = wheel in STEERED
        carrier = f"{prefix}knuckle_{wheel}" if steered else f"{prefix}car"
        inside = -math.copysign(1.0, hub[1])
        x, y, z = (0.0, 0.0, 0.0) if steered else hub
        away = DISC_THICKNESS / 2 + PAD_RADIUS + PAD_GAP
        pad = spec.body(carrier).add_body(
            name=f"{prefix}pad_{wheel}", pos=[x, y + inside * away, z + LEVER]
        )
        _add_pad(spec, pad, spec.body(f"{prefix}wheel_{wheel}"), -inside)
        if share:
            tendon.wrap_joint(pad.name, share)
    press = spec.add_actuator(
        name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_TENDON
    )
    press.set_to_motor()
    press.gear[0] = full_brake_torque(params) / (PAD_FRICTION * LEVER)
    press.ctrllimited = True
    press.ctrlrange = [0.0, 1.0]


def _add_pad(
    spec: mujoco.MjSpec, pad: mujoco.MjsBody, wheel: mujoco.MjsBody, outwards: float
) -> None:
    """A pad's joint and geom, its disc, and the contact of both."""
    pad.mass = PAD_MASS
    pad.ipos = [0.0, 0.0, 0.0]  # unset, it would be lost when written as XML
    pad.inertia = [PAD_INERTIA] * 3
    pad.explicitinertial = True
    travel = wheel.name.replace("wheel_", "travel_")
    if pad.parent.name.endswith("car") and spec.joint(travel) is not None:
        _travel_with(spec, pad, travel)
    pad.add_joint(
        name=pad.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0.0, outwards, 0.0],
        stiffness=[PAD_STIFFNESS, 0, 0],
        damping=[PAD_DAMPING, 0, 0],
        armature=PAD_ARMATURE,
    )
    unseen = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 3}
    pad.add_geom(
        name=pad.name,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[PAD_RADIUS, 0.0, 0.0],
        **unseen,
    )
    disc = pad.name.replace("pad_", "brake_disc_")
    wheel.add_geom(
        name=disc,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[DISC_RADIUS, DISC_THICKNESS / 2, 0.0],
        quat=[math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0],  # its axis along the axle
        **unseen,
    )
    spec.add_pair(
        name=pad.name,
        geomname1=disc,
        geomname2=pad.name,
        condim=3,
        friction=[PAD_FRICTION, PAD_FRICTION, 0.0, 0.0, 0.0],
        solref=SOLREF,
        solreffriction=SOLREF_FRICTION,
        solimp=SOLIMP,
    )


def _travel_with(spec: mujoco.MjSpec, pad: mujoco.MjsBody, travel: str) -> None:
    """Lets a pad move up and down with the joint of a wheel's travel."""
    name = f"{pad.name}_travel"
    pad.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0, 0, 1],
        armature=CALIPER_ARMATURE,
    )
    equality = spec.add_equality(
        name=name,
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=name,
        name2=travel,
        solref=SOLREF_TRAVEL,
        solimp=SOLIMP_TRAVEL,
    )
    equality.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]

"""The car on contact wheels with three controls, for any MuJoCo.

Tyres are spheres on explicit pairs with the ground (one contact point each, so no
scrub couple), elliptic cone, torque through open differentials. The wheels roll
without slip up to the friction limit. The car stands on them rigidly, or on the springs
of `carpark_mj.vehicle.mjcf`.

Controls of a car, one actuator each:

- `steer` [rad]: angle of the bicycle model's wheel. A hinge (the steering column)
  follows it at the steering rate, and two polynomial joint equalities turn the front
  wheels by the Ackermann condition.
- `drive` in [-1, 1]: motor torque with engine braking, so that the driven wheels
  settle at `drive` times the speed limit less `rolling_loss`.
- `brake` in [0, 1]: disc brakes, which lock the wheels before it is full.

Disc brakes: a pad on each wheel, pressed by one tendon in the brakes' shares, slides
along the axle in the wheel's carrier and rubs on a disc of the wheel: dry friction,
which stops and holds a wheel but never turns it backwards. Nothing else touches pads or
discs. With a suspension the pads travel with their wheels: in front in the knuckles,
the others tied to the wheels' travel.

Locked tyres, for a car that moves in the plane: dry friction is a vector of one length
against the slip of a tyre; MuJoCo has it for single coordinates only, or in contacts,
which hop when they slide. So the contact patch of each tyre hangs on `LINES` tendons
that end far away, each with a share of the friction: a polygon of twice as many sides
instead of a circle, 1.7 % off at most.
"""

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from carpark_mj.vehicle.mjcf import SOLIMP as SUSPENDED_SOLIMP
from carpark_mj.vehicle.mjcf import (
    STEERED,
    WHEELS,
    hub_positions,
    per_wheel,
    set_inertial,
)
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
PAD_SOLREF = (0.02, 1.0)
# A pad creeps over its disc by the force it holds. A car on a slope of 20 % rolled by 1
# to 5 mm/s at MuJoCo's usual 0.95 and the contact's own time constant.
PAD_SOLREF_FRICTION, PAD_SOLIMP = (0.004, 1.0), (0.999, 0.999, 0.001, 0.5, 2.0)
UNTOUCHED = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": 3}  # but by pairs
CALIPER_ARMATURE = 1.0  # kg, of a pad's travel
PAD_SOLREF_TRAVEL, PAD_SOLIMP_TRAVEL = (0.004, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)


def add_disc_brakes(
    spec: mujoco.MjSpec, params: VehicleParameters, prefix: str
) -> None:
    """Adds discs, pads and the actuator `brake` in [0, 1] to the car of a prefix."""
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
    grip = params.tyre.friction * params.mass * GRAVITY
    full = FULL_BRAKE * grip * params.wheel_radius  # N m, of all wheels together
    press.gear[0] = full / (PAD_FRICTION * LEVER)
    press.ctrllimited = True
    press.ctrlrange = [0.0, 1.0]


def _add_pad(
    spec: mujoco.MjSpec, pad: mujoco.MjsBody, wheel: mujoco.MjsBody, outwards: float
) -> None:
    """A pad's joint and geom, its disc, and the contact of both."""
    set_inertial(pad, PAD_MASS, [PAD_INERTIA] * 3)
    travel = wheel.name.replace("wheel_", "travel_")
    if pad.parent.name.endswith("car") and spec.joint(travel) is not None:
        with_it = f"{pad.name}_travel"  # up and down
        pad.add_joint(
            name=with_it,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0, 0, 1],
            armature=CALIPER_ARMATURE,
        )
        hard = {"solref": PAD_SOLREF_TRAVEL, "solimp": PAD_SOLIMP_TRAVEL}
        couple(spec, with_it, with_it, travel, [0.0, 1.0, 0.0, 0.0, 0.0], **hard)
    pad.add_joint(
        name=pad.name,
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=[0.0, outwards, 0.0],
        stiffness=[PAD_STIFFNESS, 0, 0],
        damping=[PAD_DAMPING, 0, 0],
        armature=PAD_ARMATURE,
    )
    pad.add_geom(
        name=pad.name,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[PAD_RADIUS, 0.0, 0.0],
        **UNTOUCHED,
    )
    disc = pad.name.replace("pad_", "brake_disc_")
    wheel.add_geom(
        name=disc,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[DISC_RADIUS, DISC_THICKNESS / 2, 0.0],
        quat=[math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0],  # its axis along the axle
        **UNTOUCHED,
    )
    spec.add_pair(
        name=pad.name,
        geomname1=disc,
        geomname2=pad.name,
        condim=3,
        friction=[PAD_FRICTION, PAD_FRICTION, 0.0, 0.0, 0.0],
        solref=PAD_SOLREF,
        solreffriction=PAD_SOLREF_FRICTION,
        solimp=PAD_SOLIMP,
    )


def couple(
    spec: mujoco.MjSpec,
    name: str,
    follower: str,
    leader: str,
    polynomial: Sequence[float],
    **solver: Any,
) -> None:
    """Adds an equality by which one joint follows a quartic of another."""
    equality = spec.add_equality(
        name=name,
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=follower,
        name2=leader,
        **solver,
    )
    equality.data[:5] = polynomial


LINES = 6
FAR = 1e6  # m; a car that slides 100 m turns a tendon by 1e-4 rad
# One over the sum of |cos| over all lines, its mean over the directions of slip.
SHARE = math.pi / (2 * LINES)
# Hard enough to hold.
LOCKED_SOLREF, LOCKED_SOLIMP = (0.005, 1.0), (0.999, 0.999, 0.001, 0.5, 2.0)
UNSEEN = 5  # group


def add_locked_tyres(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, params: VehicleParameters
) -> None:
    """Adds the tyres' friction to a car, by their loads at rest on level ground.

    The frame of `body` is the rear axle's on the ground.
    """
    wheels = zip(WHEELS, hub_positions(params), params.static_loads, strict=True)
    for wheel, (x, y, _), load in wheels:
        patch = f"{body.name}/patch_{wheel}"
        body.add_site(name=patch, pos=[x, y, 0.0], group=UNSEEN)
        for line in range(LINES):
            tendon = spec.add_tendon(name=f"{patch}{line}", group=UNSEEN)
            tendon.wrap_site(patch)
            tendon.wrap_site(_far_point(spec, line))
            tendon.frictionloss = SHARE * params.tyre.friction * load
            tendon.solref_friction = LOCKED_SOLREF
            tendon.solimp_friction = LOCKED_SOLIMP


def _far_point(spec: mujoco.MjSpec, line: int) -> str:
    """Name of the world's site in the direction of a line."""
    name = f"far{line}"
    if spec.site(name) is None:
        angle = math.pi * line / LINES
        where = [FAR * math.cos(angle), FAR * math.sin(angle), 0.0]
        spec.worldbody.add_site(name=name, pos=where, group=UNSEEN)
    return name


# Solver settings for locked wheels; with fewer iterations the car jumps.
TIMESTEP = 0.002  # s
IMPRATIO = 100.0  # what tyres and brake pads hold creeps by as much less
ITERATIONS, LS_ITERATIONS = 100, 50
TOLERANCE = 1e-12  # at 1e-8 a mirrored drive is 4 um off
SOLREF = (0.02, 1.0)
SOLIMP = (0.95, 0.95, 0.001)
# Rolling resistance as dry friction of the axles, hard enough not to creep.
SOLREF_FRICTION = (0.005, 1.0)
SOLIMP_FRICTION = (0.999, 0.999, 0.001)

# The steering column: a servo limited to a torque, working against a damper that is
# so strong that the limit is the steering rate. The armature keeps the damper from
# being stiff at the time step, which would tear the equalities while steering.
COLUMN_TORQUE = 2000.0  # N m, both front wheels
COLUMN_STIFFNESS = 40_000.0  # N m/rad
COLUMN_ARMATURE = 10.0  # kg m^2
COLUMN_MASS, COLUMN_INERTIA = 1e-3, 1e-3  # kg, kg m^2: negligible beside the car's
SOLREF_STEER = (0.004, 1.0)
SOLIMP_STEER = (0.999, 0.999, 0.001)


def steering_polynomials(params: VehicleParameters) -> np.ndarray:
    """Quartics (2, 5) for the left and right wheel angle over the bicycle angle [rad].

    Of ascending powers, zero first. Fitted to the Ackermann condition, they err by less
    than 0.03 deg up to 36 deg; a Taylor series would by half a degree.
    """
    limit = params.max_steering
    # Chebyshev nodes make least squares nearly minimax; no constant term keeps
    # straight ahead exact.
    angle = limit * np.cos(np.linspace(0.0, math.pi, 401))
    tan = np.tan(angle)
    skew = params.ackermann * params.track_width / (2 * params.wheelbase) * tan
    powers = angle[:, None] ** np.arange(1, 5)
    rows = []
    for sign in (-1.0, 1.0):
        wheel = np.arctan(tan / (1.0 + sign * skew))
        weights = np.ones_like(angle)
        fit = np.zeros(4)
        for _ in range(30):  # Lawson's algorithm: towards the minimax fit
            root = np.sqrt(weights)[:, None]
            fit, *_ = np.linalg.lstsq(powers * root, wheel * root[:, 0], rcond=None)
            weights *= np.abs(powers @ fit - wheel) + 1e-12
            weights /= weights.sum()
        rows.append([0.0, *fit])
    return np.array(rows)


def set_contact_options(spec: mujoco.MjSpec) -> None:
    """Sets the time step, the cone and the solver for contact wheels."""
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.impratio = IMPRATIO
    spec.option.iterations = ITERATIONS
    spec.option.ls_iterations = LS_ITERATIONS
    spec.option.tolerance = TOLERANCE


def add_contact_wheels(
    spec: mujoco.MjSpec,
    params: VehicleParameters,
    prefix: str,
    ground: str,
    suspension: bool = False,
) -> None:
    """Adds tyres to the car of a prefix, which touch the geom `ground`, a plane."""
    friction = params.tyre.friction
    solimp = SUSPENDED_SOLIMP if suspension else SOLIMP
    for name, wheel_load in zip(WHEELS, params.static_loads, strict=True):
        tyre = f"{prefix}tyre_{name}"
        spec.body(f"{prefix}wheel_{name}").add_geom(
            name=tyre,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[params.wheel_radius, 0, 0],
            **UNTOUCHED,
        )
        spec.add_pair(
            name=tyre,
            geomname1=ground,
            geomname2=tyre,
            condim=3,
            friction=[friction, friction, 0.0, 0.0, 0.0],
            solref=SOLREF,
            solimp=[*solimp, 0.5, 2.0],
        )
        spin = spec.joint(f"{prefix}spin_{name}")
        spin.frictionloss = (
            params.tyre.rolling_resistance * wheel_load * params.wheel_radius
        )
        spin.solref_friction = SOLREF_FRICTION
        spin.solimp_friction = [*SOLIMP_FRICTION, 0.5, 2.0]


def rolling_loss(params: VehicleParameters) -> float:
    """Reduction by rolling resistance of the speed at which `drive` settles [m/s].

    It takes c_rr g of an acceleration that falls by a_max / v_max per speed.
    """
    resistance = params.tyre.rolling_resistance * GRAVITY
    return resistance / params.max_acceleration * params.max_speed


def add_controls(spec: mujoco.MjSpec, params: VehicleParameters, prefix: str) -> None:
    """Adds the actuators `steer`, `drive` and `brake` of a car without servos."""
    _add_steering(spec, params, prefix)
    torque = params.max_acceleration * params.mass * params.wheel_radius
    name = f"{prefix}drive"
    axle = spec.add_tendon(name=name)  # fixed shares, as of open differentials
    for wheel, share in zip(WHEELS, per_wheel(params.front_drive), strict=True):
        if share:
            axle.wrap_joint(f"{prefix}spin_{wheel}", share)
    drive = spec.add_actuator(
        name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_TENDON
    )
    engine_brake = torque / (params.max_speed / params.wheel_radius)
    drive.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    drive.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    drive.gainprm[0] = torque
    drive.biasprm[2] = -engine_brake
    drive.ctrllimited = True
    drive.ctrlrange = [-params.max_reverse_speed / params.max_speed, 1.0]
    add_disc_brakes(spec, params, prefix)


def _add_steering(spec: mujoco.MjSpec, params: VehicleParameters, prefix: str) -> None:
    column = spec.body(f"{prefix}car").add_body(
        name=f"{prefix}column", pos=[params.wheelbase, 0.0, params.wheel_radius]
    )
    set_inertial(column, COLUMN_MASS, [COLUMN_INERTIA] * 3)
    name = f"{prefix}steer"
    column.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        armature=COLUMN_ARMATURE,
        damping=[COLUMN_TORQUE / params.steering_rate, 0, 0],
    )
    hard = {"solref": SOLREF_STEER, "solimp": [*SOLIMP_STEER, 0.5, 2.0]}
    for wheel, polynomial in zip(STEERED, steering_polynomials(params), strict=True):
        own = f"{prefix}steer_{wheel}"
        couple(spec, f"{prefix}ackermann_{wheel}", own, name, polynomial, **hard)
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=COLUMN_STIFFNESS)
    servo.forcelimited = True
    servo.forcerange = [-COLUMN_TORQUE, COLUMN_TORQUE]
    servo.ctrllimited = True
    servo.ctrlrange = [-params.max_steering, params.max_steering]

"""The car as MJCF: chassis, steered knuckles, four wheels, two steering servos.

The body frame is the rear-axle centre projected on the ground, x forward. Degrees of
freedom: root (0-5), steer and spin front left and right, spin rear left and right:
12 in all, and four more where contact wheels have a suspension. Steering joints carry
no range: in MJX a joint limit is a permanent solver row, and the command is clipped
before it gets there. The model has no contacts: tyre forces come from
`carpark_mj.physics.forces`.

Brush tyres stand on a spring and damper per corner, suspension and tyre in series.
The suspension of contact wheels, which are rigid, has the same rates k and c, by one
vertical slide joint per wheel: both cars heave, pitch and roll alike. The presets' ride
frequency sqrt(4 k / m) / 2 pi is 1.36 to 1.46 Hz, their damping ratio
4 c / (2 sqrt(4 k m)) about 0.35, within the 1 to 1.5 Hz and 0.2 to 0.4 of passenger
cars (Gillespie, Fundamentals of Vehicle Dynamics, ch. 5). There is no anti-roll bar: a
car rolls 7 to 9 deg/g, more than most. The slides are square to the body: no anti-dive,
roll centre on the ground.
"""

from collections.abc import Sequence
from typing import TypeVar

import jax
import mujoco
import numpy as np

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters

Number = TypeVar("Number", float, jax.Array)

TRAVEL = 0.10  # m, from rest to the stop in bump and in rebound [est]

# Of the tyres' contacts. A wheel on a slide is some nine times lighter to lift than the
# car; at the rigid car's 0.95 the contacts would be as much softer, sag 1 mm and creep
# on slopes. (1 - d) / d is a ninth here.
SOLIMP = (0.994, 0.994, 0.001)


def spring_reference(load: Number, unsprung_mass: Number, stiffness: Number) -> Number:
    """Where a corner's spring would rest without its load [m], below the wheel's place.

    From the tyre's load at rest [N], the mass of wheel and knuckle, which the spring
    does not carry [kg], and its stiffness [N/m].
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

    The joint is zero at rest, where the tyre bears a load [N]; up is positive. An
    unsprung mass [kg] moves with it.
    """
    joint = body.add_joint(
        name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], limited=True
    )
    stiffness = params.tyre.vertical_stiffness
    joint.stiffness = [stiffness, 0, 0]
    joint.damping = [params.tyre.vertical_damping, 0, 0]
    joint.springref = spring_reference(load, unsprung_mass, stiffness)
    joint.range = [-TRAVEL, TRAVEL]


WHEELS = ("fl", "fr", "rl", "rr")  # the order of every (4,) array of wheels
STEERED = ("fl", "fr")
CHASSIS = 1  # index of its body in the model of one car; 0 is the world

# Steering servo: stiff against the scrub torque of a standing tyre (about 200 N m),
# close to critically damped with the inertia below.
STEER_STIFFNESS = 40_000.0  # N m/rad
STEER_DAMPING = 550.0  # N m s/rad
STEER_TORQUE = 1000.0  # N m per wheel
STEER_ARMATURE = 1.0  # kg m^2, rack and column reflected to the wheel, estimated
STEER_FRICTION_DAMPING = 5.0  # N m s/rad


def per_wheel(front_share: float) -> list[float]:
    """An axle split as shares of the four wheels, in the order of `WHEELS`."""
    front, rear = front_share / 2, (1.0 - front_share) / 2
    return [front, front, rear, rear]


def hub_positions(params: VehicleParameters) -> np.ndarray:
    """Wheel centres (4, 3) [m] in the body frame, in the order of `WHEELS`."""
    x, y = params.wheelbase, params.track_width / 2
    z = params.wheel_radius
    return np.array([[x, y, z], [x, -y, z], [0.0, y, z], [0.0, -y, z]])


def chassis_inertial(params: VehicleParameters) -> tuple[float, np.ndarray, np.ndarray]:
    """What remains of the car's mass properties without wheels and knuckles.

    Returns:
        Mass [kg], centre of gravity (3,) [m] in the body frame, principal inertia (3,)
        [kg m^2] about it. Products of inertia are neglected.

    Raises:
        ValueError: the remainder is no rigid body.
    """
    hubs = hub_positions(params)
    masses = np.full(4, params.wheel_mass)
    masses[:2] += params.knuckle_mass
    tilt, spin = params.wheel_tilt_inertia, params.wheel_inertia
    own = np.tile([tilt, spin, tilt], (4, 1))
    own[:2] += params.knuckle_inertia
    mass = params.mass - masses.sum()
    cg = np.array([params.cg_to_rear_axle, 0.0, params.cg_height])
    com = (params.mass * cg - masses @ hubs) / mass

    def about_cg(point: np.ndarray) -> np.ndarray:
        x, y, z = point - cg
        return np.array([y * y + z * z, x * x + z * z, x * x + y * y])

    inertia = np.array([params.roll_inertia, params.pitch_inertia, params.yaw_inertia])
    for m, hub, i in zip(masses, hubs, own, strict=True):
        inertia = inertia - i - m * about_cg(hub)
    inertia = inertia - mass * about_cg(com)
    largest = inertia.max()
    if mass <= 0 or inertia.min() <= 0 or inertia.sum() < 2 * largest:
        raise ValueError(
            f"mass {params.mass} kg and inertias ({params.roll_inertia}, "
            f"{params.pitch_inertia}, {params.yaw_inertia}) kg m^2 leave no possible "
            f"chassis: mass {mass:.1f} kg, inertias {inertia.round(1).tolist()}"
        )
    return float(mass), com, inertia


def add_car(
    parent: mujoco.MjsBody,
    spec: mujoco.MjSpec,
    params: VehicleParameters,
    prefix: str,
    servos: bool = True,
    suspension: bool = False,
) -> mujoco.MjsBody:
    """Adds a car as a free body of `parent`; every name starts with `prefix`.

    With `servos` each front wheel gets a steering servo. With a `suspension` the wheels
    move up and down on springs, four degrees of freedom more (`travel_fl`...), each
    before the joints of its body.
    """
    mass, com, inertia = chassis_inertial(params)
    car = parent.add_body(name=f"{prefix}car")
    car.add_freejoint(name=f"{prefix}root")
    set_inertial(car, mass, inertia, com)
    tilt, spin = params.wheel_tilt_inertia, params.wheel_inertia
    hubs, loads = hub_positions(params), params.static_loads
    for name, hub, load in zip(WHEELS, hubs, loads, strict=True):
        travel = f"{prefix}travel_{name}"
        carrier, position = car, hub
        if name in STEERED:
            carrier = car.add_body(name=f"{prefix}knuckle_{name}", pos=hub)
            set_inertial(carrier, params.knuckle_mass, [params.knuckle_inertia] * 3)
            if suspension:
                unsprung = params.knuckle_mass + params.wheel_mass
                add_travel(carrier, params, travel, load, unsprung)
            carrier.add_joint(
                name=f"{prefix}steer_{name}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=[0, 0, 1],
                armature=STEER_ARMATURE,
                damping=STEER_FRICTION_DAMPING,
            )
            position = np.zeros(3)
            if servos:
                servo = spec.add_actuator(
                    name=f"{prefix}steer_{name}",
                    target=f"{prefix}steer_{name}",
                    trntype=mujoco.mjtTrn.mjTRN_JOINT,
                )
                servo.set_to_position(kp=STEER_STIFFNESS, kv=STEER_DAMPING)
                servo.forcelimited = True
                servo.forcerange = [-STEER_TORQUE, STEER_TORQUE]
        wheel = carrier.add_body(name=f"{prefix}wheel_{name}", pos=position)
        set_inertial(wheel, params.wheel_mass, [tilt, spin, tilt])
        if suspension and name not in STEERED:
            add_travel(wheel, params, travel, load, params.wheel_mass)
        wheel.add_joint(
            name=f"{prefix}spin_{name}",
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 1, 0],
        )
    return car


def set_inertial(
    body: mujoco.MjsBody,
    mass: float,
    inertia: Sequence[float] | np.ndarray,
    com: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
) -> None:
    """Gives a body its mass [kg], principal inertia [kg m^2] and centre of mass [m]."""
    body.mass = mass
    body.ipos = com  # unset, it would be lost when written as XML
    body.inertia = inertia
    body.explicitinertial = True


def car_model(
    params: VehicleParameters, sim_dt: float, gravity: tuple[float, float, float]
) -> mujoco.MjModel:
    """Compiles the car alone, for a time step [s] and gravity (3,) [m/s^2]."""
    spec = mujoco.MjSpec()
    spec.modelname = "car"
    spec.option.timestep = sim_dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = gravity
    add_car(spec.worldbody, spec, params, prefix="")
    return spec.compile()

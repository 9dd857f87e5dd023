"""The car on contact wheels with three controls, for any MuJoCo.

Tyres are spheres on explicit pairs with the ground (one contact point each, so no
scrub couple), elliptic cone, torque through open differentials. The wheels roll
without slip up to the friction limit; scrub torque, relaxation and exact hold belong
to the brush tyres of `carpark_mj.physics.forces`. The car stands on them rigidly, or on
the springs of `carpark_mj.vehicle.suspension`.

Controls of a car, one actuator each:

- `steer` [rad]: angle of the bicycle model's wheel. A hinge (the steering column)
  follows it at the steering rate, and two polynomial joint equalities turn the front
  wheels by the Ackermann condition.
- `drive` in [-1, 1]: motor torque with engine braking, so that the driven wheels
  settle at `drive` times the speed limit less `rolling_loss`.
- `brake` in [0, 1]: the disc brakes of `carpark_mj.vehicle.disc_brake`, which lock the
  wheels before it is full.
"""

import math

import mujoco
import numpy as np

from carpark_mj.vehicle.disc_brake import add_disc_brakes
from carpark_mj.vehicle.mjcf import STEERED, WHEELS, per_wheel
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters
from carpark_mj.vehicle.suspension import SOLIMP as SUSPENDED_SOLIMP

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
    """Quartics (2, 5) for the left and right wheel angle over the bicycle angle.

    Coefficients of ascending powers [rad], zero first, fitted to the Ackermann
    condition so that the largest error over the steering range is small (below 0.03
    deg up to 36 deg; a Taylor series would be off by half a degree).
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
    """Adds tyres to a car's wheels that collide with the geom `ground`, a plane.

    Args:
        spec: the model with the car of `mjcf.add_car` in it.
        params: the vehicle.
        prefix: of the car's names.
        ground: name of the geom.
        suspension: whether the car has one.
    """
    friction = params.tyre.friction
    solimp = SUSPENDED_SOLIMP if suspension else SOLIMP
    for name, wheel_load in zip(WHEELS, params.static_loads, strict=True):
        tyre = f"{prefix}tyre_{name}"
        spec.body(f"{prefix}wheel_{name}").add_geom(
            name=tyre,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[params.wheel_radius, 0, 0],
            mass=0.0,
            contype=0,
            conaffinity=0,
            group=3,
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
    axle = _add_axle(spec, f"{prefix}drive", prefix, per_wheel(params.front_drive))
    drive = spec.add_actuator(
        name=f"{prefix}drive", target=axle, trntype=mujoco.mjtTrn.mjTRN_TENDON
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
    column.mass = COLUMN_MASS
    column.ipos = [0.0, 0.0, 0.0]  # unset, it would be lost when written as XML
    column.inertia = [COLUMN_INERTIA] * 3
    column.explicitinertial = True
    name = f"{prefix}steer"
    column.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        armature=COLUMN_ARMATURE,
        damping=[COLUMN_TORQUE / params.steering_rate, 0, 0],
    )
    for wheel, polynomial in zip(STEERED, steering_polynomials(params), strict=True):
        equality = spec.add_equality(
            name=f"{prefix}ackermann_{wheel}",
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=f"{prefix}steer_{wheel}",
            name2=name,
            solref=SOLREF_STEER,
            solimp=[*SOLIMP_STEER, 0.5, 2.0],
        )
        equality.data[:5] = polynomial
    servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.set_to_position(kp=COLUMN_STIFFNESS)
    servo.forcelimited = True
    servo.forcerange = [-COLUMN_TORQUE, COLUMN_TORQUE]
    servo.ctrllimited = True
    servo.ctrlrange = [-params.max_steering, params.max_steering]


def _add_axle(spec: mujoco.MjSpec, name: str, prefix: str, shares: list[float]) -> str:
    """A fixed tendon that splits torque in fixed shares, as open differentials do."""
    tendon = spec.add_tendon(name=name)
    for wheel, share in zip(WHEELS, shares, strict=True):
        if share:
            tendon.wrap_joint(f"{prefix}spin_{wheel}", share)
    return name

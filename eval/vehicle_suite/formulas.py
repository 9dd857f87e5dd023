"""Expected values of vehicle dynamics, from a car's parameters alone.

Sources: Gillespie, Fundamentals of Vehicle Dynamics (1992), ch. 1, 3 and 6; Pacejka,
Tyre and Vehicle Dynamics (2012), ch. 1, 3 and 5. Signs: x forward, y left, turning
left. Axle quantities are (front, rear).
"""

import math
from typing import Literal

import numpy as np
from scipy import linalg

from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters

# What a car stands on: springs over tyre patches, which stay where they are when it
# leans (brush tyres), springs over hubs, which lean with it, or nothing soft.
Stance = Literal["patches", "hubs", "rigid"]


def rolling_mass(params: VehicleParameters) -> float:
    """Mass that accelerates [kg]: the car and its spinning wheels, m + 4 I / r^2."""
    return params.mass + 4 * params.wheel_inertia / params.wheel_radius**2


def axle_loads(params: VehicleParameters) -> tuple[float, float]:
    """Static loads m g b / L and m g a / L [N]."""
    weight = params.mass * GRAVITY / params.wheelbase
    return weight * params.cg_to_rear_axle, weight * params.cg_to_front_axle


def rolling_resistance(params: VehicleParameters) -> float:
    """c_rr m g [N]."""
    return params.tyre.rolling_resistance * params.mass * GRAVITY


def rolling_drag(params: VehicleParameters, steering: float) -> float:
    """Drive force [N] that rolling resistance takes in a turn without slip.

    sum c_rr F_i v_i over the mean speed of the driven wheels: the hubs' speeds v_i
    differ, and power is what balances.
    """
    kappa = math.tan(steering) / params.wheelbase
    half = params.track_width / 2
    ahead = kappa * params.wheelbase
    speeds = [
        (math.hypot(1 - s, ahead), abs(1 - s)) for s in (kappa * half, -kappa * half)
    ]
    front, rear = (sum(pair) / 2 for pair in zip(*speeds, strict=True))
    loads = axle_loads(params)
    power = params.tyre.rolling_resistance * (loads[0] * front + loads[1] * rear)
    return power / (params.front_drive * front + (1 - params.front_drive) * rear)


def locking_distance(params: VehicleParameters) -> float:
    """Distance [m] that wheels lock by before their friction is fully there.

    The bristles stretch by u = 3 mu F_z / k_x = 3 mu sigma_x / c_x until the patch
    slides, and give three quarters of the friction on the way: a quarter of u is lost.
    """
    tyre = params.tyre
    stretch = 3 * tyre.friction * tyre.longitudinal_relaxation / tyre.slip_stiffness
    return stretch / 4


def axle_stiffness(
    params: VehicleParameters, factors: tuple[float, float] = (1.0, 1.0)
) -> tuple[float, float]:
    """Cornering stiffness c_y F_z of the axles [N/rad]."""
    front, rear = axle_loads(params)
    c = params.tyre.cornering_stiffness
    return c * front * factors[0], c * rear * factors[1]


def turning_radius(params: VehicleParameters, steering: float) -> float:
    """R = L / tan(delta) of the rear-axle centre without any tyre slip [m]."""
    return params.wheelbase / math.tan(steering)


def front_wheel_angles(
    params: VehicleParameters, steering: float
) -> tuple[float, float]:
    """Left and right [rad] for a bicycle angle: tan d / (1 -+ f T / (2 L) tan d)."""
    tan = math.tan(steering)
    skew = params.ackermann * params.track_width / (2 * params.wheelbase) * tan
    return math.atan(tan / (1 - skew)), math.atan(tan / (1 + skew))


def kerb_circle(params: VehicleParameters) -> float:
    """D = 2 (L / sin(delta_o) + w / 2) [m] at full lock, w the tyre's width.

    L / sin is the outer wheel's radius only where it stands square to it, with exact
    Ackermann; otherwise its radius follows from that of the rear axle.
    """
    radius = turning_radius(params, params.max_steering) + params.track_width / 2
    return 2 * math.hypot(radius, params.wheelbase) + params.tyre_width


def understeer_gradient(
    params: VehicleParameters, factors: tuple[float, float]
) -> float:
    """K = (m / L) (b / C_f - a / C_r) [rad s^2/m], linear tyres."""
    front, rear = axle_stiffness(params, factors)
    share = params.mass / params.wheelbase
    return share * (params.cg_to_rear_axle / front - params.cg_to_front_axle / rear)


def lateral_load_transfer(
    params: VehicleParameters, acceleration: float, stance: Stance = "patches"
) -> float:
    """Load that moves from the inner to the outer wheels [N].

    (m h + 4 I / r) a_y / T / (1 - m g l / (k T^2)): moment of the centrifugal force and
    of the turning wheels' spin (gyroscopic), and the centre of gravity's own shift as
    the car rolls on springs k per corner, l above what it stands on: its height h over
    tyre patches, h - r over the hubs of a suspension, 0 if the car is rigid.
    """
    return _load_transfer(params, acceleration, params.track_width, stance)


def longitudinal_load_transfer(
    params: VehicleParameters, acceleration: float, stance: Stance = "patches"
) -> float:
    """Load that moves to the front axle at a deceleration [N].

    (m h + 4 I / r) a / L / (1 - m g l / (k L^2)): as for roll, with the wheels' spin
    that stops in place of their gyroscopic moment. The car pitches about the middle of
    its wheelbase, which lowers a centre of gravity ahead of it, so m h loses
    m (b - L / 2) times the pitch angle.
    """
    base = params.wheelbase
    shift = _load_transfer(params, acceleration, base, stance)
    if stance == "rigid":
        return shift
    pitch = tilt_angle(params, shift, base)
    lower = params.mass * (params.cg_to_rear_axle - base / 2) * pitch
    return shift - lower * acceleration / base


def tilt_angle(params: VehicleParameters, shift: float, base: float) -> float:
    """Pitch or roll [rad] of a load shift [N] over the wheelbase or track width [m].

    Two springs k give half the shift each: shift / (k base).
    """
    return shift / (params.tyre.vertical_stiffness * base)


def _load_transfer(
    params: VehicleParameters, acceleration: float, base: float, stance: Stance
) -> float:
    spinning = 4 * params.wheel_inertia / params.wheel_radius
    moment = (params.mass * params.cg_height + spinning) * acceleration
    above = {
        "patches": params.cg_height,
        "hubs": params.cg_height - params.wheel_radius,
        "rigid": 0.0,
    }[stance]
    # Four springs k at half the base from their middle resist tilting by k base^2.
    stiffness = params.tyre.vertical_stiffness * base**2
    return moment / base / (1 - params.mass * GRAVITY * above / stiffness)


def bounce(params: VehicleParameters) -> tuple[float, np.ndarray]:
    """The slower of heave and pitch on the suspension: damped frequency and shape.

    Eigenvectors of M^-1 K with springs k at both ends of the wheelbase; their dampers c
    are in proportion, so that zeta = c omega / (2 k) and omega_d = omega
    sqrt(1 - zeta^2). Where the sprung centre of gravity lies in the middle it is
    heave alone, sqrt(4 k / m). Pitching, the sprung mass leans over the hubs, l below
    it, and pushes the freely rolling wheels to and fro.

    Returns:
        Frequency [Hz], and speeds (2,) of the sprung centre of gravity up [m/s] and of
        pitch, nose down [rad/s].
    """
    mass, (x, _, z), inertia = chassis_inertial(params)
    above = z - params.wheel_radius
    unsprung = rolling_mass(params) - mass
    pushed = mass * unsprung / (mass + unsprung) * above**2
    k, c = params.tyre.vertical_stiffness, params.tyre.vertical_damping
    front, rear = params.wheelbase - x, -x
    # Nose down by q lifts a point x ahead by -q x.
    stiffness = (
        2
        * k
        * np.array([[2.0, -(front + rear)], [-(front + rear), front**2 + rear**2]])
    )
    stiffness[1, 1] -= mass * GRAVITY * above
    squares, shapes = linalg.eigh(stiffness, np.diag([mass, inertia[1] + pushed]))
    omega = math.sqrt(squares[0])
    zeta = c * omega / (2 * k)
    return omega * math.sqrt(1 - zeta**2) / (2 * math.pi), shapes[:, 0]


def scrub_torque(params: VehicleParameters) -> float:
    """2/3 mu F_z R_p of one front wheel turned at standstill [N m]."""
    load = axle_loads(params)[0] / 2
    return 2 / 3 * params.tyre.friction * load * params.tyre.patch_radius

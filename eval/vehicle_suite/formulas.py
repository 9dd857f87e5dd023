"""Expected values of vehicle dynamics, from a car's parameters alone.

Sources: Gillespie, Fundamentals of Vehicle Dynamics (1992), ch. 1, 3 and 6; Pacejka,
Tyre and Vehicle Dynamics (2012), ch. 1, 3, 5 and 7.2. Signs: x forward, y left, turning
left. Axle quantities are (front, rear).
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import optimize

from carpark_mj.vehicle.mjcf import STEER_STIFFNESS
from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters


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
    c, loads = params.tyre.cornering_stiffness, axle_loads(params)
    return c * loads[0] * factors[0], c * loads[1] * factors[1]


def front_wheel_angles(
    params: VehicleParameters, steering: float
) -> tuple[float, float]:
    """Left and right [rad] for a bicycle angle: tan d / (1 -+ f T / (2 L) tan d)."""
    tan = math.tan(steering)
    skew = params.ackermann * params.track_width / (2 * params.wheelbase) * tan
    return math.atan(tan / (1 - skew)), math.atan(tan / (1 + skew))


def lateral_load_transfer(params: VehicleParameters, acceleration: float) -> float:
    """Load that moves from the inner to the outer wheels [N].

    (m h + 4 I / r) a_y / T / (1 - m g h / (k T^2)): moment of the centrifugal force and
    of the turning wheels' spin (gyroscopic), and the centre of gravity's own shift as
    the car rolls on springs k per corner over tyre patches that stay where they are.
    """
    return _load_transfer(params, acceleration, params.track_width)


def longitudinal_load_transfer(params: VehicleParameters, acceleration: float) -> float:
    """Load that moves to the front axle at a deceleration [N].

    (m h + 4 I / r) a / L / (1 - m g h / (k L^2)): as for roll, with the wheels' spin
    that stops in place of their gyroscopic moment. The car pitches about the middle of
    its wheelbase, which lowers a centre of gravity ahead of it, so m h loses
    m (b - L / 2) times the pitch angle.
    """
    base = params.wheelbase
    shift = _load_transfer(params, acceleration, base)
    # Two springs k give half the shift each.
    pitch = shift / (params.tyre.vertical_stiffness * base)
    lower = params.mass * (params.cg_to_rear_axle - base / 2) * pitch
    return shift - lower * acceleration / base


def _load_transfer(
    params: VehicleParameters, acceleration: float, base: float
) -> float:
    spinning = 4 * params.wheel_inertia / params.wheel_radius
    moment = (params.mass * params.cg_height + spinning) * acceleration
    # Four springs k at half the base from their middle resist tilting by k base^2.
    stiffness = params.tyre.vertical_stiffness * base**2
    return moment / base / (1 - params.mass * GRAVITY * params.cg_height / stiffness)


class Turn(NamedTuple):
    """A steady turn: rear-axle radius [m], wheels' drag to be driven against [N]."""

    radius: float
    drag: float


def steady_turn(
    params: VehicleParameters,
    steering: float,
    speed: float,
    factors: tuple[float, float] = (1.0, 1.0),
) -> Turn:
    """Steady turn of the two-track car on brush tyres with scrub torque.

    Solves the three balances (along, across, about the rear axle) for side velocity,
    yaw rate and drive force. Each wheel's force follows from its own slip angle and
    load, its scrub moment k_t sigma_t omega / |v_i| from the twist of the patch, which
    also twists the steering servos.

    Args:
        params: the car.
        steering: commanded bicycle angle [rad], left.
        speed: of the rear axle along the car [m/s], negative in reverse.
        factors: on the cornering stiffness, front and rear.
    """
    tyre, way = params.tyre, math.copysign(1.0, speed)
    x = np.array([params.wheelbase, params.wheelbase, 0.0, 0.0])
    y = params.track_width / 2 * np.array([1.0, -1.0, 1.0, -1.0])
    static = np.repeat(axle_loads(params), 2) / 2
    cornering = np.repeat(axle_stiffness(params, factors), 2) / 2
    share = np.repeat([params.front_drive, 1.0 - params.front_drive], 2) / 2
    command = np.array([*front_wheel_angles(params, steering), 0.0, 0.0])

    def balance(unknown: np.ndarray) -> tuple[np.ndarray, float]:
        side, yaw_rate, drive = unknown[0], unknown[1], unknown[2]
        shift = lateral_load_transfer(params, speed * yaw_rate) / 2
        load = static - np.sign(y) * shift
        forward, left = speed - yaw_rate * y, side + yaw_rate * x
        along = forward * np.cos(command) + left * np.sin(command)
        twist = tyre.torsion_relaxation * yaw_rate / np.abs(along)
        scrub_limit = tyre.friction * 2 / 3 * tyre.patch_radius * load
        scrub = -scrub_limit * np.clip(twist / tyre.torsion_yield, -1, 1)
        angle = command + np.where(x > 0, scrub / STEER_STIFFNESS, 0.0)
        cos, sin = np.cos(angle), np.sin(angle)
        along, across = forward * cos + left * sin, left * cos - forward * sin
        rolling = way * tyre.rolling_resistance * load
        push = -cornering * across / np.abs(along)
        shape = np.vectorize(brush_shape)(push, tyre.friction * load)
        force_x, force_y = share * drive * params.mass - rolling, push * shape
        total_x = force_x * cos - force_y * sin
        total_y = force_x * sin + force_y * cos
        m, arm = params.mass, params.cg_to_rear_axle
        ahead = total_x.sum() + m * yaw_rate * (side + arm * yaw_rate)
        aside = total_y.sum() - m * yaw_rate * speed
        moment = (x * total_y - y * total_x + scrub).sum() - m * arm * yaw_rate * speed
        drag = way * np.sum((force_x + rolling) * (share > 0))
        return np.array([ahead, aside, moment]) / static.sum(), float(drag)

    yaw_rate = speed * math.tan(steering) / params.wheelbase
    guess = np.array([0.0, yaw_rate, way * GRAVITY / 50])
    solved = optimize.root(lambda unknown: balance(unknown)[0], guess, tol=1e-12)
    if not solved.success:
        raise ValueError(f"no steady turn at {math.degrees(steering):.1f} deg, {speed}")
    side, yaw_rate, _ = solved.x
    return Turn(abs(math.hypot(speed, side) / yaw_rate), balance(solved.x)[1])


def brush_shape(linear: float, limit: float) -> float:
    """Brush force over its linear part C s: 1 - s/3 + s^2/27, at most the limit."""
    s = max(abs(linear) / limit, 1e-12)
    capped = min(s, 3.0)
    return (1 - capped / 3 + capped**2 / 27) * capped / s

"""Expected values of vehicle dynamics, from a car's parameters alone.

Sources: Gillespie, Fundamentals of Vehicle Dynamics (1992), ch. 1, 3 and 6; Pacejka,
Tyre and Vehicle Dynamics (2012), ch. 1, 3, 5 and 7.2. Signs: x forward, y left, turning
left. Axle quantities are (front, rear).
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from scipy import linalg, optimize

from carpark_mj.vehicle.mjcf import STEER_STIFFNESS
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
    ahead = math.tan(steering)
    aside = ahead / params.wheelbase * params.track_width / 2
    sides = 1 - aside, 1 + aside
    front = sum(math.hypot(side, ahead) for side in sides) / 2
    rear = sum(map(abs, sides)) / 2
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
    c, loads = params.tyre.cornering_stiffness, axle_loads(params)
    return c * loads[0] * factors[0], c * loads[1] * factors[1]


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
    above = params.cg_height - (params.wheel_radius if stance == "hubs" else 0.0)
    above = 0.0 if stance == "rigid" else above
    # Four springs k at half the base from their middle resist tilting by k base^2.
    stiffness = params.tyre.vertical_stiffness * base**2
    return moment / base / (1 - params.mass * GRAVITY * above / stiffness)


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


def step_response(
    params: VehicleParameters, speed: float, time: np.ndarray
) -> np.ndarray:
    """Yaw rate (T,) per steering angle [1/s] after a step of the front wheels at t = 0.

    Linear single-track car with roll about an axis on the ground and relaxing tyres:
    states v_y, yaw rate r, roll angle phi and rate, the axles' bristles w and the step
    delta; dw/dt = v_contact - v w / sigma, F = -(C / sigma w + d dw/dt).
    """
    m, v, h = params.mass, speed, params.cg_height
    a, b = params.cg_to_front_axle, params.cg_to_rear_axle
    tyre = params.tyre
    rate = v / tyre.lateral_relaxation
    stiffness, damping = (
        k * params.track_width**2
        for k in (tyre.vertical_stiffness, tyre.vertical_damping)
    )
    # Rows over the states (v_y, r, phi, phi', w_f, w_r, delta).
    w_rate = np.array([[1.0, a, 0, 0, -rate, 0, -v], [1.0, -b, 0, 0, 0, -rate, 0]])
    force = -2 * tyre.lateral_damping * w_rate
    force[[0, 1], [4, 5]] -= np.array(axle_stiffness(params)) / tyre.lateral_relaxation
    # m (v_y' + v r - h phi'') = F and I phi'' = h F + (m g h - k) phi - c phi'.
    spring = np.array([0, 0, m * GRAVITY * h - stiffness, -damping, 0, 0, 0])
    total = force.sum(0)
    roll_rate = (h * total + spring) / params.roll_inertia
    side = total / m + h * roll_rate
    side[1] -= v
    yaw = (a * force[0] - b * force[1]) / params.yaw_inertia
    system = np.vstack([side, yaw, np.eye(7)[3], roll_rate, w_rate, np.zeros(7)])
    step = linalg.expm(system * (time[1] - time[0]))
    state, found = np.eye(7)[6], []
    for _ in time:
        found.append(state[1])
        state = step @ state
    return np.array(found)

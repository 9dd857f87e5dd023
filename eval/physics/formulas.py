"""What vehicle dynamics expects of a car, from its parameters alone.

Sources: Gillespie, Fundamentals of Vehicle Dynamics (1992), ch. 1, 3 and 6; Pacejka,
Tyre and Vehicle Dynamics (2012), ch. 1, 3 and 5. Signs: x forward, y left, turning
left. Axle quantities are (front, rear).
"""

import math

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
    params: VehicleParameters, acceleration: float, rigid: bool = False
) -> float:
    """Load that moves from the inner to the outer wheels [N].

    (m h + 4 I / r) a_y / T / (1 - m g h / (k T^2)): moment of the centrifugal force and
    of the turning wheels' spin (gyroscopic), and the centre of gravity's own shift as
    the car rolls on springs k per corner, unless they are rigid.
    """
    return _load_transfer(params, acceleration, params.track_width, rigid)


def longitudinal_load_transfer(
    params: VehicleParameters, acceleration: float, rigid: bool = False
) -> float:
    """Load that moves to the front axle at a deceleration [N].

    (m h + 4 I / r) a / L / (1 - m g h / (k L^2)): as for roll, with the wheels' spin
    that stops in place of their gyroscopic moment. The car pitches about the middle of
    its wheelbase, which lowers a centre of gravity ahead of it, so m h loses
    m (b - L / 2) times the pitch angle.
    """
    base = params.wheelbase
    shift = _load_transfer(params, acceleration, base, rigid)
    if rigid:
        return shift
    pitch = shift / (params.tyre.vertical_stiffness * base)
    lower = params.mass * (params.cg_to_rear_axle - base / 2) * pitch
    return shift - lower * acceleration / base


def _load_transfer(
    params: VehicleParameters, acceleration: float, base: float, rigid: bool
) -> float:
    spinning = 4 * params.wheel_inertia / params.wheel_radius
    moment = (params.mass * params.cg_height + spinning) * acceleration
    # Four springs k at half the base from their middle resist tilting by k base^2.
    stiffness = params.tyre.vertical_stiffness * base**2
    lean = 0.0 if rigid else params.mass * GRAVITY * params.cg_height / stiffness
    return moment / base / (1 - lean)


def scrub_torque(params: VehicleParameters) -> float:
    """2/3 mu F_z R_p of one front wheel turned at standstill [N m]."""
    load = axle_loads(params)[0] / 2
    return 2 / 3 * params.tyre.friction * load * params.tyre.patch_radius

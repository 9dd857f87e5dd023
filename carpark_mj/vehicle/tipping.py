"""When a car tips over: the acceleration at which wheels lift.

Quasi-static. At acceleration a the load moves by m a h; the car leans by m a h over
(stiffness - m g h), which moves it by m g h times that again. The wheels on the inside
have lifted when all of m g arm has moved.
"""

from carpark_mj.vehicle.parameters import GRAVITY, VehicleParameters


def tip_limit(mass: float, height: float, arm: float, stiffness: float) -> float:
    """Acceleration [m/s^2] at which a car's wheels lift; not positive if it falls over.

    Args:
        mass: of the car [kg].
        height: of its centre of gravity [m].
        arm: from there to the wheels about which it tips, horizontally [m].
        stiffness: against the lean [N m/rad].
    """
    return GRAVITY * arm / height * (1.0 - mass * GRAVITY * height / stiffness)


def roll_stiffness(params: VehicleParameters) -> float:
    """Of the springs of all four corners against roll [N m/rad]."""
    return params.tyre.vertical_stiffness * params.track_width**2


def pitch_stiffness(params: VehicleParameters, cg_to_rear_axle: float) -> float:
    """The same against pitch about a centre of gravity ahead of the rear axle [m]."""
    to_front = params.wheelbase - cg_to_rear_axle
    arms = cg_to_rear_axle**2 + to_front**2
    return 2.0 * params.tyre.vertical_stiffness * arms


def turning_acceleration(params: VehicleParameters) -> float:
    """Lateral acceleration at top speed on full lock [m/s^2]."""
    speed = max(params.max_speed, params.max_reverse_speed)
    return speed**2 / params.turning_radius

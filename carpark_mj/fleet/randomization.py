"""Domain randomization: every car gets its own parameters when it spawns.

What is drawn is data in the car's `Vehicle`, so nothing recompiles. The footprint is
unchanged, and so are collisions and the parked rule.
"""

import dataclasses
import math
from functools import partial

import jax
import jax.numpy as jnp

from carpark_mj.config import RandomizationConfig
from carpark_mj.config.randomization import ADDED
from carpark_mj.vehicle import Vehicle, VehicleParameters
from carpark_mj.vehicle.conditions import with_grip, with_mass
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import GRAVITY

# What brings a car's centre of gravity higher or nearer to its wheels, or brakes it.
TIPPING = ("mass", "cg_height", "cg_x", "brake_gain")
# Of the roll after a sudden turn; at 1.3 cars were seen to stay upright.
OVERSHOOT = 1.5


def randomize(config: RandomizationConfig, vehicle: Vehicle, key: jax.Array) -> Vehicle:
    """Draws one car about a nominal one.

    Args:
        config: what varies.
        vehicle: the nominal car.
        key: consumed; each parameter has its own part of it, so that switching one
            on changes no other.
    """
    ranges = config.ranges()
    keys = dict(zip(ranges, jax.random.split(key, len(ranges)), strict=True))

    def vary(name: str, nominal: jax.Array) -> jax.Array:
        if not config.varies(name):
            return nominal
        low, high = ranges[name]
        drawn = jax.random.uniform(keys[name], minval=low, maxval=high)
        return nominal + drawn if name in ADDED else nominal * drawn

    if any(map(config.varies, ("mass", "cg_x", "cg_height"))):
        cg = vehicle.cg
        cg = jnp.stack([vary("cg_x", cg[0]), cg[1], vary("cg_height", cg[2])])
        vehicle = with_mass(vehicle, vary("mass", vehicle.mass), cg)
    one = jnp.ones_like(vehicle.mass)
    vehicle = with_grip(vehicle, vary("friction", one))
    stiffness, brake = vary("tyre_stiffness", one), vary("brake_gain", one)
    tyres = dataclasses.replace(
        vehicle.tyres,
        longitudinal_stiffness=vehicle.tyres.longitudinal_stiffness * stiffness,
        lateral_stiffness=vehicle.tyres.lateral_stiffness * stiffness,
    )
    return dataclasses.replace(
        vehicle,
        tyres=tyres,
        steering_offset=vary("steering_offset", vehicle.steering_offset),
        steering_lag=vary("steering_lag", vehicle.steering_lag),
        max_deceleration=vehicle.max_deceleration * brake,
        hold_deceleration=vehicle.hold_deceleration * brake,
    )


def randomize_all(
    config: RandomizationConfig, vehicles: Vehicle, key: jax.Array
) -> Vehicle:
    """Draws cars about nominal ones (count,), which they are while nothing varies.

    Args:
        config: what varies.
        vehicles: (count,) the nominal cars.
        key: consumed.
    """
    if not config.is_on:
        return vehicles
    keys = jax.random.split(key, vehicles.mass.shape[0])
    return jax.vmap(partial(randomize, config))(vehicles, keys)


def check_randomization(
    config: RandomizationConfig, params: VehicleParameters, grade: float = 0.0
) -> None:
    """Refuses ranges from which an impossible car could be drawn.

    Each range has bounds of its own; together they must not overturn the car.

    Args:
        config: the ranges.
        params: the nominal car.
        grade: of the ground, rise over run.

    Raises:
        ValueError: naming the parameter, its range and what is allowed.
    """
    unsprung = params.mass - chassis_inertial(params)[0]
    least_mass = 2 * unsprung / params.mass
    cg_x, wheelbase = params.cg_to_rear_axle, params.wheelbase
    cg_height, radius = params.cg_height, params.wheel_radius
    allowed = {
        "mass": (least_mass, 3.0),
        "cg_x": (0.1 * wheelbase / cg_x, 0.9 * wheelbase / cg_x),
        "cg_height": (0.5 * radius / cg_height, params.height / cg_height),
        "friction": (0.01, 3.0),
        "tyre_stiffness": (0.1, 2.0),
        "brake_gain": (0.0, 3.0),
        "steering_offset": (-0.2, 0.2),
        "steering_lag": (0.0 - params.steering_lag, 10.0 - params.steering_lag),
    }
    for name, (least, most) in allowed.items():
        low, high = config.ranges()[name]
        if config.varies(name) and not least <= low <= high <= most:
            raise ValueError(
                f"randomization.{name} must lie within [{least:.3g}, {most:.3g}] for "
                f"this car, not reach from {low:.3g} to {high:.3g}"
            )
    if any(map(config.varies, TIPPING)):
        _check_tipping(config, params, grade)


def _check_tipping(
    config: RandomizationConfig, params: VehicleParameters, grade: float
) -> None:
    """Refuses ranges whose tallest, heaviest, hardest braked car could tip over."""
    height = params.cg_height * config.cg_height[1]
    heaviest, lightest = (params.mass * config.mass[k] for k in (1, 0))
    grip = GRAVITY * params.tyre.friction * config.friction[1]
    slope = GRAVITY * grade / math.hypot(1.0, grade)
    sideways = tip_limit(
        heaviest, height, params.track_width / 2, roll_stiffness(params)
    )
    pitch = [
        tip_limit(heaviest, height, arm, pitch_stiffness(params, cg_x))
        for cg_x, arm in (
            (cg_x, arm)
            for cg_x in (params.cg_to_rear_axle * factor for factor in config.cg_x)
            for arm in (cg_x, params.wheelbase - cg_x)
        )
    ]
    # Torques do not change with the load.
    pedal = max(params.max_deceleration * config.brake_gain[1], params.max_acceleration)
    asked = min(pedal * params.mass / lightest, grip)
    turning = min(OVERSHOOT * turning_acceleration(params), grip)
    for limit, needed, way in (
        (sideways, turning, "in turns"),
        (min(pitch), asked, "on the brake"),
    ):
        if limit < needed + slope:
            up_to = ", ".join(f"{n} {config.ranges()[n][1]:.3g}" for n in TIPPING)
            raise ValueError(
                f"randomization could overturn this car {way}: with {up_to} its wheels "
                f"lift at {max(limit, 0.0):.2f} m/s^2, it must bear "
                f"{needed + slope:.2f}; narrow these ranges"
            )


def tip_limit(mass: float, height: float, arm: float, stiffness: float) -> float:
    """Acceleration [m/s^2] at which a car's wheels lift; not positive if it falls over.

    Quasi-static. At acceleration a the load moves by m a h; the car leans by m a h over
    (stiffness - m g h), which moves it by m g h times that again. The wheels on the
    inside have lifted when all of m g arm has moved.

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

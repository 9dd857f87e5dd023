"""Domain randomization: every car gets its own parameters when it spawns.

What is drawn is data in the car's `Vehicle`, so nothing recompiles. The footprint is
unchanged, and so are collisions and the parked rule.
"""

import dataclasses
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.spawning.config import ADDED, RandomizationConfig
from carpark_mj.vehicle import Vehicle, VehicleParameters
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import with_grip, with_mass

# What brings a car's centre of gravity higher or nearer to its wheels, or brakes it.
TIPPING = ("mass", "cg_height", "cg_x", "brake_gain", "steering_offset")
# Of the lean after a sudden turn or stop; at 1.3 cars were seen to stay upright.
OVERSHOOT = 1.5


def randomize(config: RandomizationConfig, vehicle: Vehicle, key: jax.Array) -> Vehicle:
    """Draws one car about a nominal one.

    Each parameter has its own part of `key`, so that switching one on changes no other.
    """
    ranges = config.ranges()
    varied = [k for k, name in enumerate(ranges) if config.varies(name)]
    keys = jax.random.split(key, len(ranges))[np.array(varied)]
    bounds = jnp.array([*ranges.values()])[np.array(varied)]

    @jax.vmap  # at once, as one call of the generator is one loop
    def draw(key: jax.Array, bounds: jax.Array) -> jax.Array:
        return jax.random.uniform(key, minval=bounds[0], maxval=bounds[1])

    numbers = jnp.unstack(draw(keys, bounds))
    drawn = {[*ranges][k]: x for k, x in zip(varied, numbers, strict=True)}

    def vary(name: str, nominal: jax.Array) -> jax.Array:
        if name not in drawn:
            return nominal
        return nominal + drawn[name] if name in ADDED else nominal * drawn[name]

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
    """Draws cars (count,) about nominal ones, which they are while nothing varies."""
    if not config.is_on:
        return vehicles
    keys = jax.random.split(key, vehicles.mass.shape[0])
    return jax.vmap(partial(randomize, config))(vehicles, keys)


def check_randomization(
    config: RandomizationConfig, params: VehicleParameters, grade: float = 0.0
) -> None:
    """Refuses ranges from which an impossible car could be drawn.

    Each range has bounds of its own; together they must not overturn the car on ground
    of a grade (rise over run).
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
    ahead = [params.cg_to_rear_axle * factor for factor in config.cg_x]
    steering = params.max_steering + max(map(abs, config.steering_offset))
    curvature = math.tan(steering) / params.wheelbase
    turn = max(params.max_speed, params.max_reverse_speed) ** 2 * curvature
    sideways = [
        tip_limit(
            heaviest,
            height,
            params.track_width / 2,
            roll_stiffness(params, heaviest, (cg_x, height), turn * curvature * cg_x),
        )
        for cg_x in ahead
    ]
    lengthways: list[float] = []
    for cg_x in ahead:
        arms = cg_x, params.wheelbase - cg_x  # of the axles, about which it pitches
        pitch = 2.0 * params.tyre.vertical_stiffness * (arms[0] ** 2 + arms[1] ** 2)
        lengthways += [tip_limit(heaviest, height, arm, pitch) for arm in arms]
    # Torques do not change with the load.
    pedal = max(params.max_deceleration * config.brake_gain[1], params.max_acceleration)
    asked = min(OVERSHOOT * pedal * params.mass / lightest, grip)
    turning = min(OVERSHOOT * turn, grip)
    for limit, needed, way in (
        (min(sideways), turning, "in turns"),
        (min(lengthways), asked, "on the brake"),
    ):
        if limit < needed + slope:
            up_to = ", ".join(f"{n} {config.ranges()[n][1]:.3g}" for n in TIPPING)
            raise ValueError(
                f"randomization could overturn this car {way}: with {up_to} it tips "
                f"at {max(limit, 0.0):.2f} m/s^2 and must bear {needed + slope:.2f}; "
                "narrow these ranges"
            )


def tip_limit(mass: float, height: float, arm: float, stiffness: float) -> float:
    """Acceleration [m/s^2] at which a car tips; not positive if it falls over at rest.

    Quasi-static. At acceleration a the load moves by m a h; the car leans by m g arm /
    stiffness [N m/rad] until all of m g arm has moved, which brings its centre of
    gravity at a height [m] nearer to the wheels about which it tips, an arm [m] away,
    by h times the lean.
    """
    return GRAVITY * arm / height * (1.0 - mass * GRAVITY * height / stiffness)


def roll_stiffness(
    params: VehicleParameters, mass: float, cg: tuple[float, float], braking: float
) -> float:
    """Of the springs against roll, a mean up to where a car tips [N m/rad].

    A car with the same load on both axles rolls on four springs until both wheels of a
    side lift. Otherwise the wheel of the lighter axle lifts first. The heavier axle,
    with share s of the weight, rolls on alone until its wheel lifts at an angle of s m
    g / (k track), 2 s times as far. Meanwhile the lighter axle rises by half a track
    width times the roll. This pitch, and deceleration `braking` [m/s^2], add to the
    share: a car turns about a point beside its rear axle, and what is ahead of it
    accelerates backwards. `cg` is ahead of the rear axle and above the ground [m].
    """
    cg_x, height = cg
    rate, wheelbase = params.tyre.vertical_stiffness, params.wheelbase
    share = max(cg_x, wheelbase - cg_x) / wheelbase
    pitch = mass * GRAVITY * share / (2.0 * rate * wheelbase)
    share += height / wheelbase * (pitch + braking / GRAVITY)
    return rate * params.track_width**2 / (2.0 * min(share, 1.0))

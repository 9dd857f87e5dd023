"""Domain randomization: every car gets its own parameters when it spawns.

What is drawn is data in the car's `Vehicle`, so nothing recompiles. The footprint is
unchanged, and so are collisions and the parked rule.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.spawning.config import ADDED, RandomizationConfig
from carpark_mj.vehicle import Vehicle, VehicleParameters
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.vehicle import with_grip, with_mass


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


def check_randomization(config: RandomizationConfig, params: VehicleParameters) -> None:
    """Refuses ranges from which an impossible car could be drawn."""
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

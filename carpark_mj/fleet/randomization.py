"""Domain randomization: every car gets its own parameters when it spawns.

What is drawn is data in the car's `Vehicle`, so nothing recompiles. The footprint, and
with it every judgement of the task, stays as it is.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp

from carpark_mj.config import Distribution, RandomizationConfig
from carpark_mj.vehicle import Vehicle, VehicleParameters
from carpark_mj.vehicle.load import with_mass
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.surfaces import with_grip


def draw(distribution: Distribution, nominal: jax.Array, key: jax.Array) -> jax.Array:
    """One value () about a nominal one; see `Distribution`. `key` is consumed."""
    if distribution.kind == "uniform":
        x = jax.random.uniform(key, minval=-1.0, maxval=1.0)
    else:
        cut = distribution.NORMAL_CUT
        x = jax.random.truncated_normal(key, -cut, cut)
    x = distribution.mean + distribution.width * x
    return nominal * (1.0 + x) if distribution.relative else nominal + x


def randomize(config: RandomizationConfig, vehicle: Vehicle, key: jax.Array) -> Vehicle:
    """Draws one car about a nominal one.

    Args:
        config: what varies.
        vehicle: the nominal car.
        key: consumed; each parameter has its own part of it, so that switching one
            on changes no other.
    """
    names = config.distributions()
    keys = dict(zip(names, jax.random.split(key, len(names)), strict=True))

    def vary(name: str, nominal: jax.Array) -> jax.Array:
        distribution = names[name]
        if not distribution.is_on:
            return nominal
        return draw(distribution, nominal, keys[name])

    if config.mass.is_on or config.cg_x.is_on or config.cg_height.is_on:
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


def check_randomization(config: RandomizationConfig, params: VehicleParameters) -> None:
    """Refuses distributions that could draw an impossible car.

    Raises:
        ValueError: naming the distribution, what it may draw and what is allowed.
    """
    unsprung = params.mass - chassis_inertial(params)[0]
    allowed = {
        "mass": (params.mass, 2 * unsprung, 3 * params.mass),
        "cg_x": (
            params.cg_to_rear_axle,
            0.1 * params.wheelbase,
            0.9 * params.wheelbase,
        ),
        "cg_height": (params.cg_height, params.wheel_radius / 2, params.height),
        "friction": (1.0, 0.01, 3.0),
        "tyre_stiffness": (1.0, 0.1, 2.0),
        "brake_gain": (1.0, 0.0, 3.0),
        "steering_offset": (0.0, -0.2, 0.2),
        "steering_lag": (params.steering_lag, 0.0, 10.0),
    }
    for name, (nominal, least, most) in allowed.items():
        distribution = config.distributions()[name]
        low, high = distribution.bounds(nominal)
        if distribution.is_on and not least <= low <= high <= most:
            raise ValueError(
                f"randomization.{name} must stay within [{least:.3g}, {most:.3g}] for "
                f"this car, not reach from {low:.3g} to {high:.3g}"
            )

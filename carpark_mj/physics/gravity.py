"""Gravity on sloping ground: the ground is level, gravity is tilted.

A ramp is a band of the lot, seen from which gravity is tilted more. The whole car has
the slope at its centre of gravity; x is measured along the ground.
"""

import math

import jax
import jax.numpy as jnp

from carpark_mj.config import SimConfig
from carpark_mj.physics.vectors import Vector
from carpark_mj.vehicle.parameters import GRAVITY

EASE = 3.0  # m, over which the grade of a ramp begins and ends [est]


def gravity_vector(sim: SimConfig) -> tuple[float, float, float]:
    """Gravity (3,) [m/s^2] seen from ground of the configured slope, normal to it."""
    g = GRAVITY / math.hypot(1.0, sim.grade_x)
    return (-g * sim.grade_x, 0.0, -g)


def gravity_at(sim: SimConfig, x: jax.Array) -> Vector:
    """The same [m/s^2] at places (...) along world x [m], on a ramp or off it."""
    if not sim.has_ramp:
        values = gravity_vector(sim)
        return tuple(jnp.asarray(value, x.dtype) for value in values)  # pyright: ignore
    grade = grade_at(sim, x)
    g = GRAVITY / jnp.sqrt(1.0 + grade * grade)
    return -g * grade, jnp.zeros_like(g), -g


def grade_at(sim: SimConfig, x: jax.Array) -> jax.Array:
    """Slope (...) of the ground along world x at places (...) [m], rise over run."""
    start, end, grade = sim.ramp
    within = jnp.minimum(x - start, end - x) * (1.0 / EASE) + 1.0
    return sim.grade_x + grade * jnp.clip(within, 0.0, 1.0)

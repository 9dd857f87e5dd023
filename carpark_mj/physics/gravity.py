"""Gravity on sloping ground: the ground is level, gravity is tilted."""

import math

from carpark_mj.config import SimConfig
from carpark_mj.vehicle.parameters import GRAVITY


def gravity_vector(sim: SimConfig) -> tuple[float, float, float]:
    """Gravity (3,) [m/s^2] seen from ground of the configured slope, normal to it."""
    g = GRAVITY / math.hypot(1.0, sim.grade_x)
    return (-g * sim.grade_x, 0.0, -g)

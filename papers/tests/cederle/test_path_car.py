"""Points on paths: by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_papers.cederle.junction.cars import BRAKING, PathCars
from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    Route,
    project,
    stack_routes,
)

ROUTES = stack_routes([Route(*ends) for ends in CONNECTIONS])
CARS = PathCars(SimConfig(ctrl_dt=0.1))
step = jax.jit(CARS.step)


def start(along, speed):
    along = jnp.full(len(CONNECTIONS), along)
    return CARS.init(ROUTES, along, jnp.full_like(along, speed))


def test_braking_from_the_speed_limit_takes_the_way_of_the_formula():
    """13.89^2 / (2 * 7) = 13.78 m, and then the car stands."""
    state = start(5.0, 13.89)
    for _ in range(40):
        state = step(state, ROUTES, jnp.zeros_like(state.along))
    way = 13.89**2 / (2 * BRAKING)
    np.testing.assert_allclose(state.along - 5.0, way, atol=0.02)
    assert not state.speed.any()


def test_cars_accelerate_to_their_target_and_no_further():
    state = start(0.0, 0.0)
    for k in range(10):
        state = step(state, ROUTES, jnp.full_like(state.along, 12.5))
        np.testing.assert_allclose(state.speed, 0.3 * (k + 1), rtol=1e-5)
    np.testing.assert_allclose(state.along, 1.5, rtol=1e-4)


def test_cars_stay_on_their_routes_and_take_curves_slowly():
    state = start(10.0, 13.89)
    fastest = jnp.zeros_like(state.along)
    for _ in range(80):
        state = step(state, ROUTES, jnp.full_like(state.along, 15.0))
        motion = CARS.read(state)
        off = project(ROUTES, motion.xy)[1]
        on_map = state.along < ROUTES.length
        assert np.abs(np.where(on_map, off, 0.0)).max() < 1e-3
        begin, end = ROUTES.curve.T
        in_curve = (state.along > begin) & (state.along < end)
        fastest = jnp.maximum(fastest, jnp.where(in_curve, state.speed, 0.0))
    curved = np.isfinite(ROUTES.curve_speed)
    np.testing.assert_array_less(fastest[curved], ROUTES.curve_speed[curved] + 0.31)
    assert (fastest[~curved] > 13.8).all()


def test_the_steering_angle_is_that_of_the_curve():
    """Halfway round the left turn, whose radius is about 6.4 m; straight before."""
    left = [ends == ("south-SN", "west-EW") for ends in CONNECTIONS].index(True)
    middle = CARS.init(ROUTES, ROUTES.curve.mean(axis=1), jnp.ones(6)).steering[left]
    assert float(middle) == pytest.approx(np.arctan(2.3 / 6.4), abs=0.15)
    assert float(start(5.0, 1.0).steering[left]) == pytest.approx(0.0, abs=1e-4)

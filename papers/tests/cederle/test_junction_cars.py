"""Cars at the junction: on their paths, and steered along them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.geometry import box_corners
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.physics.mjx import MjxPhysics
from carpark_mj.vehicle import preset
from carpark_papers.cederle.junction.cars import BRAKING, GAIN, PathCars, SteeredCars
from carpark_papers.cederle.junction.roads import (
    CONNECTIONS,
    SPEED_LIMIT,
    Route,
    on_road,
    project,
    stack_routes,
)

NAMES = list(CONNECTIONS)
ROUTES = stack_routes([Route(*ends) for ends in NAMES])
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
    left = NAMES.index(("south-SN", "west-EW"))
    middle = CARS.init(ROUTES, ROUTES.curve.mean(axis=1), jnp.ones(6)).steering[left]
    assert float(middle) == pytest.approx(np.arctan(2.3 / 6.4), abs=0.15)
    assert float(start(5.0, 1.0).steering[left]) == pytest.approx(0.0, abs=1e-4)


STEERED = {
    "bicycle": SteeredCars(BicyclePhysics(SimConfig(ctrl_dt=0.1)), preset("city")),
    "mjx": SteeredCars(MjxPhysics(SimConfig(ctrl_dt=0.1)), preset("city")),
}
START = 3.0  # m


@functools.cache
def programs(kind):
    """`init`, and one program that drives all routes at given target speeds."""
    cars = STEERED[kind]

    def step(state, target):
        state = cars.step(state, ROUTES, jnp.full(len(NAMES), target))
        return state, cars.read(state)

    return jax.jit(cars.init), jax.jit(lambda s, ts: jax.lax.scan(step, s, ts))


def drive(kind, targets, speed=SPEED_LIMIT):
    """Motions (steps, routes) from `speed` at target speeds (100,) [m/s]."""
    (init, run), full = programs(kind), jnp.ones(len(NAMES))
    state = init(ROUTES, START * full, speed * full)
    return run(state, jnp.asarray(targets, jnp.float32))[1]


def follow(motion):
    """Distances along and off the routes (steps, routes), and who is still on them."""
    along, off = jax.vmap(project, in_axes=(None, 0))(ROUTES, motion.xy)
    alive = np.asarray(along < ROUTES.length - 1.0)
    return np.asarray(along), np.where(alive, np.abs(off), 0.0), alive


@pytest.mark.parametrize("target", [15.0, 12.5])
@pytest.mark.parametrize("kind", STEERED)
def test_cars_keep_to_their_routes_at_the_speeds_used(kind, target):
    """Measured: 0.26 m (bicycle) and 0.39 m (mjx) turning left, 0.40 and 0.48 right."""
    motion = drive(kind, np.full(100, target))
    _, off, alive = follow(motion)
    straight = ~np.isfinite(np.asarray(ROUTES.curve_speed))
    assert off[:, straight].max() < 1e-3
    assert off.max() < {"bicycle": 0.45, "mjx": 0.55}[kind]
    on = jax.vmap(on_road)(box_corners(motion.pose_w, motion.size))
    assert np.asarray(on).all(axis=-1)[alive].all()
    speed = np.asarray(motion.speed)
    assert speed[40, straight] == pytest.approx(target, abs=0.3)
    assert (~alive[-1]).all()  # everybody has got there


@pytest.mark.parametrize("kind", STEERED)
def test_steered_braking_takes_the_way_of_the_formula(kind):
    """At 7 m/s^2 until the controller asks for less, below 7 / `GAIN` = 2.3 m/s.

    Then the speed falls by e every 1 / `GAIN`. Turning wheels add to the mass that the
    brakes stop, in the physics that has wheels.
    """
    motion = drive(kind, np.zeros(100))
    along, off, _ = follow(motion)
    way = along[-1] - START
    assert off.max() < 1e-2
    car, gentle = preset("city"), BRAKING / GAIN
    wheels = 4 * car.wheel_inertia / car.wheel_radius**2 / car.mass
    braking = BRAKING / (1.0 + (wheels if kind == "mjx" else 0.0))
    expected = (SPEED_LIMIT**2 - gentle**2) / (2 * braking) + gentle / GAIN
    np.testing.assert_allclose(way, expected, rtol=0.02)
    assert np.abs(np.asarray(motion.speed)[40:]).max() < 0.01  # and stand


@pytest.mark.parametrize("kind", STEERED)
def test_cars_start_again_and_close_on_their_target_speed(kind):
    targets = np.repeat([0.0, 12.5], [40, 60])
    speed = np.asarray(drive(kind, targets).speed)
    straight = NAMES.index(("west-WE", "east-WE"))
    assert np.abs(speed[39]).max() < 0.01
    # At 3 m/s^2 less what the tyres' rolling takes.
    assert speed[60, straight] == pytest.approx(3.0 * 2.1, rel=0.1)
    assert 11.8 < speed[-1, straight] < 13.0


@pytest.mark.parametrize("kind", STEERED)
def test_a_moving_start_is_one_of_rolling_wheels(kind):
    """At the target speed from the start: nothing slips, turns or has to settle.

    Rolling resistance, 0.012 g, would take 0.06 m/s in the five steps.
    """
    motion = drive(kind, np.full(100, 10.0), speed=10.0)
    np.testing.assert_allclose(motion.speed[:5], 10.0, atol=0.06)
    trace = np.asarray(motion.trace_w[:5]).swapaxes(1, 2).reshape(10, len(NAMES), 3)
    way = np.diff(trace, axis=0)
    np.testing.assert_allclose(np.hypot(*way[..., :2].T), 0.5, rtol=0.01)
    assert np.abs(way[..., 2]).max() < 1e-4

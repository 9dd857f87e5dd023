"""The kinematic bicycle against an independent integration, and its properties."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.physics.bicycle import BicyclePhysics, advance
from carpark_mj.vehicle import COMPACT

PHYSICS = BicyclePhysics(SimConfig())
STEP = jax.jit(PHYSICS.step)
CARS = 16


def cars_at(compact, pose):
    pose = jnp.asarray(pose, jnp.float32)
    vehicle = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (pose.shape[0], *x.shape)), compact
    )
    return PHYSICS.init(pose, vehicle)


@pytest.fixture(scope="module")
def state(compact):
    return cars_at(compact, np.zeros((CARS, 3)))


def run(state, *stretches):
    """What is read after every step of stretches: controls (2,) and how often."""
    read = []
    for control, count in stretches:
        for _ in range(count):
            state = STEP(state, jnp.tile(jnp.float32(control), (CARS, 1)))
            read.append(PHYSICS.read(state))
    return read


def highway_env(pose, speed, steering, length, seconds, steps=20_000):
    """Tiny explicit Euler steps of highway-env's `Vehicle.step`, in float64."""
    x, y, yaw = map(float, pose)
    dt = seconds / steps
    for _ in range(steps):
        beta = math.atan(1 / 2 * math.tan(steering))
        x += speed * math.cos(yaw + beta) * dt
        y += speed * math.sin(yaw + beta) * dt
        yaw += speed * math.sin(beta) / (length / 2) * dt
    return x, y, yaw


@pytest.mark.parametrize(
    ("speed", "steering"), [(3.0, 0.5), (-2.0, 0.3), (1.0, -0.6), (2.0, 0.0)]
)
def test_motion_agrees_with_tiny_steps_of_highway_envs_equations(speed, steering):
    pose, length, seconds = (1.0, -2.0, 0.7), 2.6, 1.0
    after, given = jnp.array(pose), map(jnp.array, (speed, steering, length))
    given = (*given, 0.01)
    for _ in range(100):
        after = advance(after, *given)
    expected = highway_env(pose, speed, steering, length, seconds)
    np.testing.assert_allclose(after, expected, atol=3e-4)


def test_a_steered_car_drives_the_circle_of_its_steering(state):
    # Full lock reached, the rear axle runs about a point at L / tan(steering) from it.
    read = run(state, ([1.0, 1.0], 40))
    steering = COMPACT.max_steering
    np.testing.assert_allclose(read[-1].steering, steering, rtol=1e-5)
    radius, centres = COMPACT.wheelbase / math.tan(steering), []
    for vehicle in read[-12:]:
        x, y, yaw = np.asarray(vehicle.pose_w[0], float)
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        left = np.array([-ahead[1], ahead[0]])
        centres.append([x, y] - COMPACT.centre_offset * ahead + radius * left)
    assert np.ptp(centres, axis=0).max() < 2e-3
    last = read[-1]
    np.testing.assert_allclose(last.yaw_rate, last.speed / radius, rtol=1e-5)


def test_pedal_accelerates_to_the_limits_brakes_and_holds(state):
    read = run(state, ([0.0, 1.0], 25), ([0.0, -1.0], 30), ([0.0, 0.0], 10))
    speed = np.array([r.speed[0] for r in read])
    gain = COMPACT.max_acceleration * 0.2
    np.testing.assert_allclose(speed[:5], gain * np.arange(1, 6), rtol=1e-3)
    assert abs(speed[24] - COMPACT.max_speed) < 0.01
    assert speed[24] <= COMPACT.max_speed + 1e-5
    # Braking takes max_deceleration off; it ends at rest, and only then drives back.
    loss = COMPACT.max_deceleration * 0.2
    np.testing.assert_allclose(np.diff(speed[24:27]), -loss, rtol=1e-3)
    assert abs(speed[54] + COMPACT.max_reverse_speed) < 0.01
    # No pedal leaves the speed alone above walking pace: there is no resistance.
    np.testing.assert_allclose(speed[55:], speed[54], atol=1e-5)


def test_a_car_on_the_brake_stays_where_it_is(state):
    read = run(dataclasses.replace(state, speed=jnp.full(CARS, 0.2)), ([0.3, 0.0], 3))
    assert np.all(read[0].speed == 0.0)
    np.testing.assert_array_equal(read[-1].pose_w, read[0].pose_w)
    assert (read[0].pose_w[:, 0] < 0.01).all()


def test_mirrored_steering_mirrors_and_a_batch_is_its_cars(state, compact):
    def driven(state, controls):
        for control in controls:
            state = STEP(state, jnp.asarray(control, jnp.float32))
        return np.asarray(PHYSICS.read(state).pose_w)

    control = np.random.default_rng(0).uniform(-1, 1, (15, CARS, 2))
    pose = driven(state, control)
    mirrored = driven(state, control * [-1.0, 1.0])
    np.testing.assert_allclose(mirrored, pose * [1, -1, -1], rtol=1e-5, atol=1e-5)
    assert np.ptp(pose, axis=0).min() > 0.1
    np.testing.assert_array_equal(driven(state, control[:, ::-1]), pose[::-1])
    # Moved starts move the drive.
    elsewhere = cars_at(compact, np.tile([3.0, -1.0, np.pi / 2], (CARS, 1)))
    x, y, yaw = np.asarray(pose, float).T
    expected = np.stack([3.0 - y, -1.0 + x, yaw + np.pi / 2], axis=-1)
    found = driven(elsewhere, control)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_traces_are_of_the_whole_step(state):
    fast = dataclasses.replace(state, speed=jnp.full(CARS, 2.0))
    trace = np.asarray(run(fast, ([0.0, 0.1], 1))[0].trace_w)
    assert trace.shape == (CARS, SimConfig().num_traces, 3)
    gaps = np.linalg.norm(np.diff(trace[..., :2], axis=1), axis=-1)
    np.testing.assert_allclose(gaps, 2.0 * 0.05, rtol=0.02)


def test_a_car_that_came_out_non_finite_is_put_back_and_flagged(state):
    broken = dataclasses.replace(state, speed=state.speed.at[3].set(jnp.nan))
    read = run(broken, ([0.0, 1.0], 1))[0]
    np.testing.assert_array_equal(read.finite, np.arange(CARS) != 3)
    assert np.isfinite(read.pose_w).all()
    assert not read.velocity_b[3].any()
    np.testing.assert_array_equal(read.pose_w[3], 0.0)

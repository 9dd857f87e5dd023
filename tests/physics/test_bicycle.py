"""The kinematic bicycle against an independent integration, and its properties."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, SimConfig
from carpark_mj.env import ParkingEnv
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


def run(state, controls):
    """The states read after each of the controls (steps, cars, 2)."""
    read = []
    for control in controls:
        state = STEP(state, jnp.asarray(control, jnp.float32))
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
    after = jnp.array(pose)
    for _ in range(100):
        after = advance(
            after, jnp.array(speed), jnp.array(steering), jnp.array(length), 0.01
        )
    expected = highway_env(pose, speed, steering, length, seconds)
    np.testing.assert_allclose(after, expected, atol=3e-4)


def test_a_steered_car_drives_the_circle_of_its_steering(state):
    # Full lock reached, the rear axle runs about a point at L / tan(steering) from it.
    read = run(state, [np.tile([1.0, 1.0], (CARS, 1))] * 40)
    steering = COMPACT.max_steering
    np.testing.assert_allclose(read[-1].steering, steering, rtol=1e-5)
    radius = COMPACT.wheelbase / math.tan(steering)
    centres = []
    for vehicle in read[-12:]:
        x, y, yaw = np.asarray(vehicle.pose_w[0], float)
        rear = np.array([x, y]) - COMPACT.centre_offset * np.array(
            [math.cos(yaw), math.sin(yaw)]
        )
        centres.append(rear + radius * np.array([-math.sin(yaw), math.cos(yaw)]))
    assert np.ptp(centres, axis=0).max() < 2e-3
    last = read[-1]
    np.testing.assert_allclose(last.yaw_rate, last.speed / radius, rtol=1e-5)


def test_pedal_accelerates_to_the_limits_brakes_and_holds(state):
    full, halt = np.tile([0.0, 1.0], (CARS, 1)), np.zeros((CARS, 2))
    read = run(state, [full] * 25 + [-full] * 30 + [halt] * 10)
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


def test_a_car_on_the_brake_stays_where_it_is(compact):
    state = cars_at(compact, np.zeros((CARS, 3)))
    state = dataclasses.replace(state, speed=jnp.full(CARS, 0.2))
    read = run(state, [np.tile([0.3, 0.0], (CARS, 1))] * 3)
    assert np.all(read[0].speed == 0.0)
    np.testing.assert_array_equal(read[-1].pose_w, read[0].pose_w)
    assert (read[0].pose_w[:, 0] < 0.01).all()


def test_mirrored_steering_mirrors_the_drive_and_a_batch_is_its_cars(state, compact):
    control = np.random.default_rng(0).uniform(-1, 1, (15, CARS, 2))
    read = run(state, control)
    mirrored = run(state, control * [-1.0, 1.0])
    sign = np.array([1.0, -1.0, -1.0])
    np.testing.assert_allclose(
        mirrored[-1].pose_w, read[-1].pose_w * sign, rtol=1e-5, atol=1e-5
    )
    assert np.ptp(read[-1].pose_w, axis=0).min() > 0.1
    swapped = run(state, control[:, ::-1])
    np.testing.assert_array_equal(swapped[-1].pose_w, read[-1].pose_w[::-1])
    # Moved starts move the drive.
    elsewhere = cars_at(compact, np.tile([3.0, -1.0, np.pi / 2], (CARS, 1)))
    x, y, yaw = np.asarray(read[-1].pose_w, float).T
    expected = np.stack([3.0 - y, -1.0 + x, yaw + np.pi / 2], axis=-1)
    np.testing.assert_allclose(
        run(elsewhere, control)[-1].pose_w, expected, rtol=1e-4, atol=1e-4
    )


def test_starts_at_rest_where_told_and_traces_the_whole_step(compact):
    pose = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, -2.0]] * (CARS // 2), np.float32)
    state = cars_at(compact, pose)
    read = PHYSICS.read(state)
    np.testing.assert_allclose(read.pose_w, pose, atol=1e-6)
    assert not read.velocity_b.any()
    assert read.trace_w.shape == (CARS, SimConfig().num_traces, 3)
    fast = dataclasses.replace(state, speed=jnp.full(CARS, 2.0))
    trace = np.asarray(run(fast, [np.tile([0.0, 0.1], (CARS, 1))])[0].trace_w)
    gaps = np.linalg.norm(np.diff(trace[..., :2], axis=1), axis=-1)
    np.testing.assert_allclose(gaps, 2.0 * 0.05, rtol=0.02)


def test_a_car_that_came_out_non_finite_is_put_back_and_flagged(state):
    broken = dataclasses.replace(state, speed=state.speed.at[3].set(jnp.nan))
    read = run(broken, [np.tile([0.0, 1.0], (CARS, 1))])[0]
    np.testing.assert_array_equal(read.finite, np.arange(CARS) != 3)
    assert np.isfinite(read.pose_w).all()
    assert not read.velocity_b[3].any()
    np.testing.assert_array_equal(read.pose_w[3], 0.0)


def test_the_task_runs_on_it():
    env = ParkingEnv(EnvConfig(physics="bicycle"))
    assert env.action_spec.choices == ()
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    step = jax.jit(env.step)
    for _ in range(5):
        state, timestep = step(state, jnp.full((2, 2), 0.5))
    assert timestep.observation.shape == (2, env.observation_size)
    assert np.isfinite(timestep.observation).all()
    assert (timestep.motion.speed > 0.5).all()

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.vehicle import COMPACT, Vehicle, make_vehicle
from carpark_mj.vehicle.drive import (
    HOLD_PEDAL,
    HOLD_SPEED,
    SWITCH_SPEED,
    ackermann,
    steer_towards,
    wheel_torques,
)

ANGLES = np.radians([-34.2, -20.0, -5.0, 5.0, 20.0, 34.2])
FORCE_TO_TORQUE = COMPACT.mass * COMPACT.wheel_radius
# Below this, float32 rounding of sums of torques of up to 4000 N m; measured 5e-4.
TORQUE_TOLERANCE = 2e-3  # N m


@pytest.fixture(scope="module")
def torques(compact: Vehicle):
    """Summed drive and brake torque [N m] for arrays of pedals and speeds."""
    function = jax.jit(jax.vmap(lambda p, v: wheel_torques(compact, p, v)))

    def summed(pedal, speed) -> tuple[np.ndarray, np.ndarray]:
        pedal, speed = np.broadcast_arrays(np.float32(pedal), np.float32(speed))
        drive, brake = function(pedal.ravel(), speed.ravel())
        return np.asarray(drive).sum(1), np.asarray(brake).sum(1)

    return summed


def grid(pedals: np.ndarray, speeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    pedal, speed = np.meshgrid(pedals, speeds)
    return pedal.ravel(), speed.ravel()


@pytest.mark.parametrize("fraction", [0.0, 0.6, 1.0])
def test_cotangents_of_the_front_wheels_differ_by_track_over_wheelbase(fraction: float):
    vehicle = make_vehicle(dataclasses.replace(COMPACT, ackermann=fraction))
    left, right = np.asarray(
        jax.vmap(lambda a: ackermann(vehicle, a))(jnp.array(ANGLES))
    ).T
    difference = 1 / np.tan(right) - 1 / np.tan(left)  # outer - inner in a left turn
    expected = fraction * COMPACT.track_width / COMPACT.wheelbase
    # float32 rounding of cotangents of up to 11, measured 3e-6.
    assert difference == pytest.approx(np.full(6, expected), abs=2e-5)


def test_front_wheels_without_ackermann_are_parallel():
    vehicle = make_vehicle(dataclasses.replace(COMPACT, ackermann=0.0))
    for angle in ANGLES:
        # float32 rounding of tan and arctan.
        assert ackermann(vehicle, jnp.array(angle)) == pytest.approx(angle, rel=1e-6)


def test_the_bicycle_angle_lies_between_both_wheels_with_the_inner_one_larger(
    compact: Vehicle,
):
    for angle in ANGLES:
        left, right = np.abs(ackermann(compact, jnp.array(angle)))
        inner, outer = (left, right) if angle > 0 else (right, left)
        assert outer < abs(angle) < inner


def test_steering_left_mirrors_steering_right(compact: Vehicle):
    for angle in ANGLES:
        left, right = ackermann(compact, jnp.array(angle))
        mirrored = ackermann(compact, jnp.array(-angle))
        assert mirrored.tolist() == [-right, -left]


@pytest.mark.parametrize("steer", [-1.0, -0.3, 0.7, 1.0])
def test_steering_reaches_its_target_at_the_limited_rate(
    compact: Vehicle, steer: float
):
    angle, dt = jnp.zeros(()), 0.01
    steps = []
    for _ in range(200):
        new = steer_towards(compact, angle, jnp.array(steer), dt)
        steps.append(float(new - angle))
        angle = new
    limit = COMPACT.steering_rate * dt
    moving = np.abs(steps) > 1e-6
    # float32 rounding of angles up to 0.6 rad: 6e-8.
    assert np.abs(steps).max() == pytest.approx(limit, abs=1e-7)
    assert angle == pytest.approx(steer * COMPACT.max_steering, abs=1e-7)
    assert moving.sum() == np.ceil(abs(steer) * COMPACT.max_steering / limit)


def test_steering_commands_beyond_the_lock_are_clipped(compact: Vehicle):
    at_lock = jnp.array(COMPACT.max_steering)
    assert steer_towards(compact, at_lock, jnp.array(5.0), 0.01) == at_lock
    assert steer_towards(compact, -at_lock, jnp.array(-5.0), 0.01) == -at_lock


def test_a_pedal_against_the_motion_brakes_in_proportion(torques):
    pedal, speed = grid(
        np.linspace(0.1, 1, 7), np.array([-1.9, -1, -0.3, -SWITCH_SPEED])
    )
    for sign in (1, -1):
        drive, brake = torques(sign * pedal, sign * speed)
        expected = pedal * COMPACT.max_deceleration * FORCE_TO_TORQUE
        assert drive.tolist() == [0.0] * len(drive)
        assert brake == pytest.approx(expected, abs=TORQUE_TOLERANCE)


def test_a_pedal_against_a_crawl_drives_the_new_way(torques):
    pedal, speed = grid(np.linspace(0.1, 1, 7), np.array([-0.099, -0.05, -0.001]))
    for sign in (1, -1):
        drive, brake = torques(sign * pedal, sign * speed)
        expected = sign * pedal * COMPACT.max_acceleration * FORCE_TO_TORQUE
        assert brake.tolist() == [0.0] * len(brake)
        assert drive == pytest.approx(expected, abs=TORQUE_TOLERANCE)


def test_a_pedal_along_the_motion_accelerates_in_proportion(torques):
    # Low enough for the speed limiter not to act: 2 m/s^2 x 0.4 s below the limit.
    pedal, speed = grid(np.linspace(0.1, 1, 7), np.array([0.0, 0.3, 1.1]))
    for sign in (1, -1):
        drive, brake = torques(sign * pedal, sign * speed)
        expected = sign * pedal * COMPACT.max_acceleration * FORCE_TO_TORQUE
        assert brake.tolist() == [0.0] * len(brake)
        assert drive == pytest.approx(expected, abs=TORQUE_TOLERANCE)


def test_no_pedal_at_walking_pace_holds_the_car_on_the_brake(torques):
    below = HOLD_PEDAL * 0.99
    pedal, speed = grid(np.linspace(-below, below, 5), np.linspace(-0.29, 0.29, 6))
    drive, brake = torques(pedal, speed)
    expected = np.full(30, COMPACT.hold_deceleration * FORCE_TO_TORQUE)
    assert drive.tolist() == [0.0] * 30
    assert brake == pytest.approx(expected, abs=10 * TORQUE_TOLERANCE)


def test_no_pedal_at_speed_lets_the_car_coast(torques):
    drive, brake = torques(0.0, np.array([-1.9, -HOLD_SPEED, HOLD_SPEED, 2.9]))
    assert brake.tolist() == [0.0] * 4
    assert drive.tolist() == [0.0] * 4


def test_the_hold_is_stronger_than_friction_so_that_the_wheels_lock():
    assert COMPACT.hold_deceleration > COMPACT.tyre.friction * 9.81


def test_the_drive_fades_at_the_speed_limit_and_retards_beyond_it(torques):
    limits = np.array([COMPACT.max_speed, -COMPACT.max_reverse_speed])
    pedals = np.array([1.0, -1.0])
    drive, brake = torques(pedals, limits)
    # max_speed - speed is exactly 0 in float32.
    assert drive.tolist() == [0.0, 0.0]
    drive, brake = torques(pedals, limits * 1.1)
    assert (drive * pedals < 0).all()
    assert brake.tolist() == [0.0, 0.0]
    drive, _ = torques(pedals, limits * 0.95)
    full = COMPACT.max_acceleration * FORCE_TO_TORQUE
    assert (drive * pedals > 0).all()
    assert (drive * pedals < full).all()


def test_pedals_beyond_one_count_as_one(torques):
    for speed in (-1.0, 0.0, 1.0):
        assert torques(7.0, speed) == torques(1.0, speed)
        assert torques(-7.0, speed) == torques(-1.0, speed)


@pytest.mark.parametrize("front", [0.0, 0.4, 1.0])
def test_torque_shares_sum_to_one_and_are_equal_across_an_axle(front: float):
    params = dataclasses.replace(
        COMPACT, front_drive=front, front_brake=max(front, 0.01)
    )
    vehicle = make_vehicle(params)
    for share, expected in (
        (vehicle.drive_share, front),
        (vehicle.brake_share, max(front, 0.01)),
    ):
        # float32 rounding.
        assert share.sum() == pytest.approx(1.0, abs=1e-6)
        assert share[:2].sum() == pytest.approx(expected, abs=1e-6)
        assert share[0] == share[1]
        assert share[2] == share[3]

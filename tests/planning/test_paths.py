"""Paths of a rear axle, and how far a car rolls."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.planned import CAR

from carpark_mj.config import SimConfig
from carpark_mj.physics.bicycle import BicyclePhysics
from carpark_mj.planning.paths import (
    BLEND,
    CREEP,
    SHIFT_TIME,
    STEP,
    hold_distances,
    make_path,
)
from carpark_mj.vehicle import COMPACT, make_vehicle

RADIUS = 5.0


def line(length, way=1):
    s = np.arange(0.0, length + STEP / 2, STEP)
    return np.stack([way * s, 0 * s, 0 * s], axis=-1)


def arc(angle, side=1):
    """A turn of `RADIUS` from the origin, to the left for side 1."""
    turn = np.arange(0.0, angle, STEP / RADIUS)
    return np.stack(
        [RADIUS * np.sin(turn), side * RADIUS * (1 - np.cos(turn)), side * turn], -1
    )


def test_a_path_is_cut_where_the_gear_changes():
    there = line(3.0)
    back = there[-1] + line(1.0, way=-1)[1:]
    path = make_path(np.concatenate([there, back]), CAR)
    assert [segment.gear for segment in path.segments] == [1, -1]
    assert [segment.length for segment in path.segments] == pytest.approx([3.0, 1.0])
    assert path.length == pytest.approx(4.0)
    assert path.shifts == 1
    np.testing.assert_allclose(path.segments[1].pose[0], [3.0, 0.0, 0.0])


def test_driving_turning_the_wheels_and_shifting_take_time():
    there = line(3.0)
    back = there[-1] + line(1.0, way=-1)[1:]
    path = make_path(np.concatenate([there, back]), CAR)
    # 1.56 m at 1.2 m/s, 1.44 m of braking by 0.5 m/s^2; 1 m of braking; the shift.
    assert path.duration == pytest.approx(1.3 + 2.4 + 2.0 + SHIFT_TIME, abs=0.1)
    turn = arc(1.0)
    straight = line(len(turn) * STEP - STEP)
    more = make_path(turn, CAR).duration - make_path(straight, CAR).duration
    wheels = math.atan(CAR.wheelbase / RADIUS) / CAR.steering_rate
    assert more == pytest.approx(wheels, rel=0.05)


def test_a_tiny_move_to_and_fro_is_left_out():
    there = line(2.0)
    jolt = there[-1] + line(0.02, way=-1)[1:]
    path = make_path(np.concatenate([there, jolt, jolt[-1] + line(2.0)[1:]]), CAR)
    assert [segment.gear for segment in path.segments] == [1]
    assert path.length == pytest.approx(4.0, abs=0.05)
    assert make_path(np.zeros((5, 3)), CAR) is None  # a path of one place


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("way", [1, -1])
def test_on_an_arc_the_wheels_follow_from_radius_and_wheelbase(way, side):
    pose = arc(1.0, side)
    path = make_path(pose if way == 1 else pose[::-1], CAR)
    [segment] = path.segments
    assert segment.gear == way
    expected = side * math.atan(CAR.wheelbase / RADIUS)
    np.testing.assert_allclose(segment.steering, expected, atol=1e-3)


def test_the_wheels_can_follow_and_the_car_can_stop():
    left = arc(1.0)
    right = arc(1.0, side=-1)
    cos, sin = math.cos(left[-1, 2]), math.sin(left[-1, 2])
    turned = right[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    right = np.column_stack([turned, right[:, 2]]) + left[-1]
    [segment] = make_path(np.concatenate([left, right[1:]]), CAR).segments
    rate = np.abs(np.gradient(segment.steering, segment.distance))
    fast = segment.speed > CREEP + 1e-6
    assert (rate * segment.speed)[fast].max() <= CAR.steering_rate * 1.01
    # Lock to lock over BLEND, not at once.
    jump = 2 * math.atan(CAR.wheelbase / RADIUS)
    assert rate.max() == pytest.approx(jump / BLEND, rel=0.1)
    slowing = np.diff(segment.speed**2) / (2 * np.diff(segment.distance))
    assert slowing.min() >= -0.5 * 1.01
    assert segment.speed[-1] == 0.0


def test_a_car_whose_pedal_is_released_rolls_as_far_as_is_planned():
    speed = np.array([0.05, 0.1, 0.2, 0.25, 0.295, 0.2999])  # below `CREEP`
    assert speed.max() < CREEP
    physics = BicyclePhysics(SimConfig())
    cars = jax.tree.map(
        lambda x: jnp.broadcast_to(x, (len(speed), *x.shape)), make_vehicle(COMPACT)
    )
    state = physics.init(jnp.zeros((len(speed), 3)), cars)
    state = physics.set_speed(state, jnp.array(speed, jnp.float32))
    step = jax.jit(physics.step)
    for _ in range(5):
        state = step(state, jnp.zeros((len(speed), 2)))
    motion = physics.read(state)
    assert np.abs(motion.velocity_b).max() == 0.0
    planned = np.interp(speed, *hold_distances())
    np.testing.assert_allclose(motion.pose_w[:, 0], planned, atol=2e-3)

"""The car on contact wheels: steering equalities, controls, and what they do."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from carpark_mj.scene import parts
from carpark_mj.vehicle import COMPACT
from carpark_mj.vehicle.contact_wheels import (
    BRAKE_DAMPING,
    add_contact_wheels,
    add_controls,
    set_contact_options,
    steering_polynomials,
)
from carpark_mj.vehicle.mjcf import add_car, per_wheel
from carpark_mj.vehicle.parameters import kerb_to_kerb


def wheel_angles(params, angle):
    """Ackermann by its definition: both wheels point at one centre."""
    if angle == 0:
        return 0.0, 0.0
    radius = params.wheelbase / math.tan(angle)
    half = params.track_width / 2
    return tuple(math.atan(params.wheelbase / (radius + s * half)) for s in (-1, 1))


@pytest.mark.parametrize("lock", [25.0, 30.0, 34.2, 36.0])
def test_polynomials_fit_the_ackermann_condition_within_three_hundredths(lock):
    circle = kerb_to_kerb(
        COMPACT.wheelbase, COMPACT.track_width, COMPACT.tyre_width, math.radians(lock)
    )
    params = dataclasses.replace(COMPACT, turning_circle=circle)
    assert math.degrees(params.max_steering) == pytest.approx(lock)
    left, right = steering_polynomials(params)
    for angle in np.linspace(-params.max_steering, params.max_steering, 301):
        fitted = [np.polyval(p[::-1], angle) for p in (left, right)]
        error = np.degrees(np.abs(np.subtract(fitted, wheel_angles(params, angle))))
        assert error.max() < 0.03
    # The car is symmetric: left lock mirrors right lock, and straight is straight.
    np.testing.assert_allclose(left * [1, 1, -1, 1, -1], right, atol=1e-9)
    assert left[0] == right[0] == 0.0


class Driven:
    """A car on level ground, at rest."""

    def __init__(self, tilt=0.0):
        spec = mujoco.MjSpec()
        set_contact_options(spec)
        spec.option.gravity = [-9.81 * math.sin(tilt), 0, -9.81 * math.cos(tilt)]
        parts.add_ground(spec)
        add_car(spec.worldbody, spec, COMPACT, "", servos=False)
        add_contact_wheels(spec, COMPACT, "", parts.GROUND)
        add_controls(spec, COMPACT, "")
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def run(self, seconds, steer=0.0, drive=0.0, brake=0.0):
        """Holds the controls; rows of (x, speed, column angle, left, right)."""
        rows = []
        for _ in range(round(seconds / self.model.opt.timestep)):
            for name, value in (("steer", steer), ("drive", drive), ("brake", brake)):
                self.data.actuator(name).ctrl = value
            mujoco.mj_step(self.model, self.data)
            angles = [self.data.joint(f"steer{s}").qpos[0] for s in ("", "_fl", "_fr")]
            rows.append([self.data.qpos[0], self.data.qvel[0], *angles])
        return np.array(rows)


def test_steering_keeps_its_rate_and_the_equalities_hold_while_it_moves():
    car = Driven()
    rows = car.run(2.5, steer=COMPACT.max_steering)
    rate = np.diff(rows[:, 2]) / car.model.opt.timestep
    assert rate.max() < 1.01 * COMPACT.steering_rate
    assert rows[-1, 2] == pytest.approx(COMPACT.max_steering, abs=1e-4)
    lock_time = COMPACT.max_steering / COMPACT.steering_rate
    reached = np.argmax(rows[:, 2] > 0.97 * COMPACT.max_steering)
    assert reached * car.model.opt.timestep == pytest.approx(lock_time, rel=0.1)
    expected = [wheel_angles(COMPACT, angle) for angle in rows[:, 2]]
    error = np.degrees(np.abs(rows[:, 3:] - expected))
    assert error.max() < 0.06  # 0.03 of it the polynomials'


def test_drive_settles_near_its_share_of_the_speed_limit_both_ways():
    for drive in (1.0, 0.5, -COMPACT.max_reverse_speed / COMPACT.max_speed):
        speed = Driven().run(8.0, drive=drive)[-1, 1]
        # Rolling resistance costs at most c_rr g of the 2 m/s^2: 6 % of full drive.
        wanted = drive * COMPACT.max_speed
        assert abs(wanted) - 0.25 < abs(speed) < abs(wanted)
        assert speed * drive > 0


def test_full_brake_stops_as_its_limit_says_and_the_car_stays_put():
    car = Driven()
    x, speed = car.run(4.0, drive=0.8)[-1, :2]
    rows = car.run(3.0, brake=1.0)
    assert abs(rows[-1, 1]) < 1e-6
    # Spinning parts add 4 I / r^2 to the mass, rolling resistance helps, and below the
    # torque limit the damper stops more gently than v^2 / 2a.
    stop = speed**2 / (2 * COMPACT.max_deceleration)
    assert 0.85 * stop < rows[-1, 0] - x < 1.1 * stop


def test_the_brake_is_viscous_and_creeps_on_a_slope():
    """As its documentation says; brake and engine are dampers side by side."""
    grade = math.atan(0.05)
    car = Driven(tilt=grade)
    speed = -car.run(6.0, brake=1.0)[-1, 1]
    weight = 9.81 * COMPACT.mass * (math.sin(grade) - COMPACT.tyre.rolling_resistance)
    engine = COMPACT.max_acceleration * COMPACT.mass * COMPACT.wheel_radius**2
    damping = BRAKE_DAMPING + engine / COMPACT.max_speed
    assert speed == pytest.approx(weight * COMPACT.wheel_radius**2 / damping, rel=0.01)


def test_locked_wheels_do_not_throw_the_car():
    """Full torque on all axles against the damper: the car slides and stays down."""
    car = Driven()
    car.run(6.0, drive=1.0, steer=0.4)
    car.model.actuator("brake").forcerange = [-2e4, 2e4]
    car.run(2.0, brake=1.0, steer=0.4)
    assert np.abs(car.data.qvel[:3]).max() < 1e-3
    assert abs(car.data.qpos[2]) < 1e-3


def test_torque_is_dealt_out_in_fixed_shares():
    model = Driven().model
    for tendon, share in (("drive", COMPACT.front_drive), ("brake", 0.68)):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        data.qvel[:] = 0
        spins = [model.joint(f"spin_{w}").dofadr[0] for w in ("fl", "fr", "rl", "rr")]
        row = model.tendon(tendon).id
        data.qvel[spins] = [1.0, 2.0, 3.0, 4.0]
        mujoco.mj_fwdVelocity(model, data)
        assert data.ten_velocity[row] == pytest.approx(
            np.dot(per_wheel(share), [1.0, 2.0, 3.0, 4.0])
        )

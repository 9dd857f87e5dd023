"""When the holding brake closes, opens and eases off, and an automatic creeps."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.vehicle import COMPACT, Vehicle
from carpark_mj.vehicle.drive import (
    CREEP_SPEED,
    HOLD_SPEED,
    Actuators,
    close_hold,
    hold_braking,
    init_actuators,
    press_pedal,
    roll_freely,
)

AUTOMATIC = 0.4  # m/s^2


def closed(vehicle: Vehicle, hold: float, pedal: float, speed: float, dt=0.01) -> float:
    asked = [jnp.array(x, jnp.float32) for x in (hold, pedal, speed)]
    return float(close_hold(vehicle, *asked, dt))


def test_the_hold_closes_where_a_slow_car_is_not_driven_along_its_motion(
    compact: Vehicle,
):
    for way in (1, -1):
        for speed in (0.0, 0.05, 0.29):
            assert closed(compact, 0.0, way * 0.04, way * speed) > 0.0  # no pedal
        assert closed(compact, 0.0, -way * 0.2, way * 0.29) > 0.0
        assert closed(compact, 0.0, way * 0.2, way * 0.29) == 0.0
        # A faster car coasts and brakes without it.
        for pedal in (0.0, -0.2, 0.2):
            assert closed(compact, 0.0, way * pedal, way * HOLD_SPEED) == 0.0
    hold = 0.0
    for _ in range(500):
        hold = closed(compact, hold, 0.0, 0.0)
    assert hold == COMPACT.hold_deceleration


def test_a_hold_stays_until_the_pedal_drives_the_car_along_its_motion(compact: Vehicle):
    full = COMPACT.hold_deceleration
    for speed in (0.5, 8.0):  # slides, wheels locked
        for way in (1, -1):
            assert closed(compact, full, 0.0, way * speed) == full
            assert closed(compact, full, -way * 1.0, way * speed) == full
            assert closed(compact, full, way * 0.05, way * speed) == 0.0
    # Half closed it goes on closing, though the car has become faster.
    assert closed(compact, 0.5, 0.0, 0.5) > 0.5
    # A slope may pull the car back before the drive takes over.
    for speed in (-0.2, -0.01, 0.0, 0.01):
        assert closed(compact, full, 0.5, speed) == full


def test_the_hold_takes_over_what_the_pedal_brakes_with(compact: Vehicle):
    for pedal in (0.06, 0.3, 1.0):
        hold = closed(compact, 0.0, -pedal, 0.29)
        braked = float(hold_braking(compact, jnp.array(hold), jnp.array(0.29)))
        eased = hold + np.sqrt(2 * 3.0 * 0.29)
        service = pedal * COMPACT.max_deceleration
        # It also closes for the substep of 10 ms, by less than 0.1 m/s^2.
        assert min(service, eased) - 1e-4 <= braked <= min(service + 0.1, eased) + 1e-4


def test_the_hold_eases_off_as_the_car_comes_to_rest(compact: Vehicle):
    speed = jnp.array([HOLD_SPEED, 0.2, 0.1, 0.05, 0.01, 0.0])
    braked = np.asarray(hold_braking(compact, jnp.array(0.3), speed))
    assert (np.diff(braked) < 0).all()
    assert braked[-1] == pytest.approx(0.3, abs=1e-5)
    full = hold_braking(compact, jnp.array(COMPACT.hold_deceleration), speed)
    assert full == pytest.approx(COMPACT.hold_deceleration)
    assert not hold_braking(compact, jnp.array(0.0), speed).any()


def test_cars_start_on_their_hold_and_without_it_where_they_roll(compact: Vehicle):
    start = init_actuators(compact)
    assert start.hold == COMPACT.hold_deceleration
    assert roll_freely(start, jnp.array(0.0)).hold == COMPACT.hold_deceleration
    for speed in (-1.0, 0.1):
        assert roll_freely(start, jnp.array(speed)).hold == 0.0


def idling(vehicle: Vehicle, drive: float, hold: float, pedal: float, speed: float):
    """Acceleration by the drive [m/s^2], hold and brake of an automatic 10 ms later."""
    creeping = dataclasses.replace(vehicle, creep=jnp.array(AUTOMATIC))
    before = Actuators(jnp.zeros(()), jnp.array(drive), jnp.array(hold))
    pressed, now = jnp.array(pedal, jnp.float32), jnp.array(speed, jnp.float32)
    after, brake = press_pedal(creeping, before, pressed, now, now, 0.01)
    to_torque = COMPACT.mass * COMPACT.wheel_radius
    return float(after.drive) / to_torque, float(after.hold), float(brake)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_an_automatic_creeps_while_no_brake_is_pressed(compact: Vehicle, way: float):
    half = CREEP_SPEED / 2
    for drive, pedal, speed, expected in [
        (100.0, 0.0, 0.0, AUTOMATIC),  # the way of the last drive, from rest
        (100.0, 0.0, half, AUTOMATIC / 2),
        (0.0, 0.0, half, AUTOMATIC / 2),  # the way it rolls, after the brake
        (100.0, 0.0, -0.2, AUTOMATIC),  # against a slope that pulls it back
        (100.0, 0.0, CREEP_SPEED, 0.0),
        (0.0, 0.06, 0.0, AUTOMATIC),  # more than a light pedal asks
        (0.0, 0.5, 0.0, 1.0),  # less than this one
    ]:
        got, hold, brake = idling(compact, way * drive, 0.0, way * pedal, way * speed)
        assert got == pytest.approx(way * expected, abs=1e-5)
        assert hold == brake == 0.0


def test_a_brake_ends_the_creep_and_holds_the_car(compact: Vehicle):
    assert idling(compact, 100.0, 0.0, -0.5, 1.0)[0] == 0.0  # the service brake
    drive, hold, brake = idling(compact, 100.0, 0.0, -0.5, 0.2)
    assert hold > 0.0  # closes, and stays when the pedal is released
    assert brake > 0.0
    drive, after, brake = idling(compact, 0.0, hold, 0.0, 0.1)
    assert (drive, after > hold) == (0.0, True)
    start = COMPACT.hold_deceleration  # a car begins held
    assert idling(compact, 0.0, start, 0.0, 0.0)[:2] == (0.0, start)

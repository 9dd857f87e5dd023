"""From keys and gamepads to actions."""

import numpy as np
import pytest

from carpark_mj.play.driving import (
    KEY_PEDAL,
    KEYS,
    STEER_RATE,
    Controls,
    from_gamepad,
    from_keys,
    stop,
)

STEP = 0.2  # s


def hold(keys, controls=None, speed=0.0, steps=1):
    controls = controls or Controls()
    for _ in range(steps):
        controls = from_keys({*keys}, controls, speed, STEP)
    return controls


@pytest.mark.parametrize(
    ("keys", "steer", "pedal"),
    [
        ((), 0, 0),
        (("LEFT",), 1, 0),
        (("D",), -1, 0),
        (("UP",), 0, 1),
        (("S",), 0, -1),
        (("W", "A"), 1, 1),
        (("LEFT", "RIGHT", "UP", "DOWN"), 0, 0),
    ],
)
def test_keys_steer_and_drive(keys, steer, pedal):
    assert {*keys} <= {*KEYS}
    controls = hold(keys)
    assert np.sign(controls.steer) == steer
    assert controls.pedal == pytest.approx(pedal * KEY_PEDAL)


def test_the_wheel_turns_at_a_rate_and_comes_back():
    turned = hold(["LEFT"])
    assert turned.steer == pytest.approx(STEER_RATE * STEP)
    assert hold(["LEFT"], steps=20).steer == 1.0
    assert hold([], turned).steer == pytest.approx(0.0)
    assert hold([], hold(["RIGHT"], steps=20)).steer == pytest.approx(-0.6)


def test_the_brake_acts_against_the_motion_and_lets_a_standing_car_stand():
    assert hold(["SPACE", "UP"], speed=2.0).pedal == -1.0
    assert hold(["SPACE"], speed=-2.0).pedal == 1.0
    assert hold(["SPACE"]).pedal == stop(0.05) == 0.0


def gamepad(stick=0.0, left=-1.0, right=-1.0):
    return from_gamepad([stick, 0.0, 0.0, 0.0, left, right])


def test_a_gamepad_at_rest_does_nothing_and_at_the_stops_everything():
    assert gamepad() == Controls(0.0, 0.0)
    assert gamepad(stick=0.09).steer == 0.0  # dead zone
    assert gamepad(stick=-1.0).steer == 1.0
    assert gamepad(stick=1.0).steer == -1.0
    assert gamepad(right=1.0).pedal == 1.0
    assert gamepad(left=1.0).pedal == -1.0
    assert gamepad(left=0.0, right=0.0).pedal == 0.0
    assert 0.0 < gamepad(stick=-0.2).steer < 0.2


def test_actions_stay_in_range():
    action = Controls(1.5, -3.0).action
    assert action.dtype == np.float32
    np.testing.assert_array_equal(action, [1.0, -1.0])

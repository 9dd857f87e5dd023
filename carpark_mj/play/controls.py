"""From keys and gamepads to steering and pedal, both in [-1, 1]."""

import dataclasses
from collections.abc import Sequence, Set

import numpy as np

LEFT, RIGHT = ("LEFT", "A"), ("RIGHT", "D")
AHEAD, BACK = ("UP", "W"), ("DOWN", "S")
BRAKE = ("SPACE",)
KEYS = (*LEFT, *RIGHT, *AHEAD, *BACK, *BRAKE)

# [est] By trial: as quick as a hand at a wheel, and gentle enough to park with.
STEER_RATE = 2.0  # 1/s, while a key is held, and back to the middle without
KEY_PEDAL = 0.6
DEADZONE = 0.1  # of a stick's travel
STANDING = 0.1  # m/s, below which the brake key leaves the car to its brake

# Axes of GLFW's gamepads: right is 1; triggers rest at -1.
STICK, LEFT_TRIGGER, RIGHT_TRIGGER = 0, 4, 5


@dataclasses.dataclass(frozen=True)
class Controls:
    """Controls of a driver.

    Attributes:
        steer: left is 1.
        pedal: ahead is 1; against the motion it brakes.
    """

    steer: float = 0.0
    pedal: float = 0.0

    @property
    def action(self) -> np.ndarray:
        """(2,) float32 steer and pedal."""
        return np.array([self.steer, self.pedal], np.float32).clip(-1.0, 1.0)


def from_keys(
    held: Set[str], before: Controls, speed: float, seconds: float
) -> Controls:
    """Steers step by step while keys are held, and back to the middle without.

    Args:
        held: names of `KEYS`.
        before: the controls until now.
        speed: of the car [m/s], forwards positive.
        seconds: since `before`.
    """
    wanted = _any(held, LEFT) - _any(held, RIGHT)
    most = STEER_RATE * seconds
    steer = before.steer + float(np.clip(wanted - before.steer, -most, most))
    pedal = KEY_PEDAL * (_any(held, AHEAD) - _any(held, BACK))
    if _any(held, BRAKE):
        pedal = stop(speed)
    return Controls(steer, pedal)


def from_gamepad(axes: Sequence[float]) -> Controls:
    """Left stick steers, the right trigger drives ahead, the left one back."""
    stick = -axes[STICK]
    past = max(0.0, abs(stick) - DEADZONE) / (1.0 - DEADZONE)
    pedal = (axes[RIGHT_TRIGGER] - axes[LEFT_TRIGGER]) / 2
    return Controls(float(np.copysign(past, stick)), pedal)


def stop(speed: float) -> float:
    """The pedal that brakes a car of some speed [m/s] and holds it."""
    return 0.0 if abs(speed) < STANDING else -float(np.sign(speed))


def _any(held: Set[str], names: Sequence[str]) -> int:
    return int(any(name in held for name in names))

"""Refusals in one sentence, shared by the configs."""

import math
from typing import get_args


def choose(name: str, value: str, literal: object) -> None:
    """Refuses a value that the `Literal` does not list."""
    if value not in get_args(literal):
        raise ValueError(
            f"unknown {name} {value!r}; choose from {sorted(get_args(literal))}"
        )


def at_least(config: object, minimum: float, *names: str) -> None:
    """Refuses attributes below a minimum, infinite or NaN."""
    for name in names:
        value = getattr(config, name)
        if not (math.isfinite(value) and value >= minimum):
            raise ValueError(f"{name} must be at least {minimum}, not {value}")


def positive(config: object, *names: str) -> None:
    """Refuses attributes that are not positive and finite."""
    for name in names:
        value = getattr(config, name)
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, not {value}")


def ratio(config: object, *names: str) -> None:
    """Refuses attributes outside [0, 1]."""
    for name in names:
        value = getattr(config, name)
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{name} must lie in [0, 1], not {value}")

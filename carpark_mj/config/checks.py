"""Refusals in one sentence, shared by the configs."""

import math
from typing import Any, get_args

Range = tuple[float, float]  # lowest and highest value; equal = fixed


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


def require_range(name: str, value: Any, least: float, most: float) -> None:
    """Refuses what is no `Range` of finite numbers within bounds.

    Raises:
        ValueError: naming the value and what is allowed.
    """
    # Ranges are part of a config's hash, so no lists.
    good = isinstance(value, tuple) and len(value) == 2
    good = good and all(isinstance(x, int | float) and math.isfinite(x) for x in value)
    if not (good and least <= value[0] <= value[1] <= most):
        within = f" within [{least:.4g}, {most:.4g}]" if math.isfinite(most) else ""
        raise ValueError(
            f"{name} must be a lowest and a highest number{within}, not {value!r}"
        )

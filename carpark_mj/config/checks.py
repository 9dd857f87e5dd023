"""Refusals in one sentence, shared by the configs."""

import dataclasses
import math
import numbers
import reprlib
from types import NoneType
from typing import Any, get_args

Range = tuple[float, float]  # lowest and highest value; equal = fixed


def require_choice(name: str, value: str, literal: object) -> None:
    """Refuses a value that the `Literal` does not list."""
    if value not in get_args(literal):
        raise ValueError(
            f"unknown {name} {value!r}; choose from {sorted(get_args(literal))}"
        )


def require_whole(config: object, minimum: int, *names: str) -> None:
    """Refuses attributes that are not whole numbers of at least a minimum."""
    for name in names:
        require_count(name, getattr(config, name), minimum)


def require_count(name: str, value: Any, minimum: int) -> None:
    """Refuses what is not a whole number of at least a minimum."""
    if type(value) is bool or not isinstance(value, numbers.Integral):
        raise ValueError(f"{name} must be a whole number, not {value!r}")
    if value < minimum:
        raise ValueError(f"{name} must be at least {minimum}, not {value}")


def require_at_least(config: object, minimum: float, *names: str) -> None:
    """Refuses attributes below a minimum, infinite, NaN or no numbers."""
    for name in names:
        value = getattr(config, name)
        if not (is_finite(value) and value >= minimum):
            raise ValueError(f"{name} must be at least {minimum}, not {value}")


def require_positive(config: object, *names: str) -> None:
    """Refuses attributes that are not positive and finite."""
    for name in names:
        value = getattr(config, name)
        if not (is_finite(value) and value > 0):
            raise ValueError(f"{name} must be positive, not {value}")


def require_ratio(config: object, *names: str) -> None:
    """Refuses attributes outside [0, 1]."""
    for name in names:
        value = getattr(config, name)
        if not (is_finite(value) and 0.0 <= value <= 1.0):
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


def require_kinds(config: object, **kinds: Any) -> None:
    """Refuses attributes that are no instances of the named types.

    Raises:
        ValueError: naming the attribute, its value and the type.
    """
    for name, kind in kinds.items():
        value = getattr(config, name)
        if not isinstance(value, kind):
            raise ValueError(f"{name} must be of {_kind_names(kind)}, not {value!r}")


def require_kind(name: str, value: object, kind: Any) -> None:
    """Refuses an argument of a function that is no instance of a type.

    Raises:
        TypeError: naming the argument, its value and the type.
    """
    if not isinstance(value, kind):
        raise TypeError(
            f"{name} must be of {_kind_names(kind)}, not {reprlib.repr(value)}"
        )


def require_unset(config: Any, where: str, *names: str) -> None:
    """Refuses attributes other than their defaults where they have no effect.

    Raises:
        ValueError: naming the attribute, its value and where that is.
    """
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name in names and value != field.default:
            raise ValueError(
                f"{field.name} {value!r} has no effect {where}: leave it out"
            )


def require_plain(config: Any, path: str = "") -> None:
    """Refuses lists and what is declared `bool` but is none, in nested configs too.

    Configs are hashed, by JAX as static arguments, and lists cannot be.

    Raises:
        ValueError: naming the attribute and its value.
    """
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.type is bool and type(value) is not bool:
            raise ValueError(f"{path}{field.name} must be True or False, not {value!r}")
        if isinstance(value, list):
            raise ValueError(f"{path}{field.name} must be a tuple, not {value}")
        if dataclasses.is_dataclass(value):
            require_plain(value, f"{path}{field.name}.")


def _kind_names(kind: Any) -> str:
    kinds = kind.__args__ if hasattr(kind, "__args__") else (kind,)
    return " or ".join("None" if k is NoneType else k.__name__ for k in kinds)


def is_finite(value: Any) -> bool:
    """Whether a value is a finite number."""
    if type(value) is bool or not isinstance(value, numbers.Real):
        return False
    return math.isfinite(value)

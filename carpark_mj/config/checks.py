"""Refusals in one sentence, shared by the configs."""

import dataclasses
import functools
import math
import numbers
import reprlib
from collections.abc import Callable, Iterable
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from carpark_mj.extensions import unknown_name

Range = tuple[float, float]  # lowest and highest value; equal = fixed
IntRange = tuple[int, int]  # both ends included
RANGES = Range, IntRange
LARGEST_WHOLE, LARGEST = 2**31 - 1, 3.4028235e38  # of int32 and float32
MAX_SEED = 2**32 - 1  # what a key takes; others would be taken modulo 2**32
FARTHEST = 1e4  # m; float32 resolves a millimetre there


class Bounds(NamedTuple):
    """Bounds of a field, in its annotation: `Annotated[float, Bounds(ge=0.0)]`.

    Every number of a tuple lies within them; `Range` and `IntRange` rise.
    """

    ge: float = -math.inf  # least value
    gt: float = -math.inf  # that it must exceed
    le: float = math.inf  # greatest value
    lt: float = math.inf  # that it must not reach
    unit: str = ""  # for messages

    def admit(self, value: Any) -> bool:
        """Whether a number, or every number of a tuple, lies within the bounds."""
        if isinstance(value, tuple):
            return all(map(self.admit, value))
        within = self.ge <= value <= self.le and self.gt < value < self.lt
        return within and is_finite(value)

    def __str__(self) -> str:
        return f"{self._words()} {self.unit}".rstrip()

    def _words(self) -> str:
        least, most = max(self.ge, self.gt), min(self.le, self.lt)
        if least == -math.inf and most == math.inf:
            return "be finite"
        if most == math.inf and self.gt == 0.0:
            return "be positive"
        if most == math.inf:
            above = "more than" if self.gt == least else "at least"
            return f"be {above} {_show(least)}"
        if least == -math.inf:
            below = "less than" if self.lt == most else "at most"
            return f"be {below} {_show(most)}"
        left, right = "[("[self.gt == least], "])"[self.lt == most]
        return f"lie in {left}{_show(least)}, {_show(most)}{right}"


def _show(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"


Positive = Annotated[float, Bounds(gt=0.0)]
NonNegative = Annotated[float, Bounds(ge=0.0)]
Ratio = Annotated[float, Bounds(ge=0.0, le=1.0)]
Finite = Annotated[float, Bounds()]
Count = Annotated[int, Bounds(ge=1)]
Natural = Annotated[int, Bounds(ge=0)]
Seed = Annotated[int, Bounds(ge=0, le=MAX_SEED)]


def require_choice(name: str, value: str, literal: object) -> None:
    """Refuses a value that the `Literal` does not list."""
    require_name(name, value, get_args(literal))


def require_name(name: str, value: str, known: Iterable[str]) -> None:
    """Refuses a value that is not among the known names."""
    if value not in (names := sorted(known)):
        raise ValueError(unknown_name(name, value, names))


def require_number(name: str, value: Any, bounds: Bounds) -> None:
    """Refuses a value that is no number within bounds."""
    if not (is_finite(value) and bounds.admit(value)):
        raise ValueError(f"{name} must {bounds}, not {value!r}")


def require_count(name: str, value: Any, least: int, most: float = math.inf) -> None:
    """Refuses values other than whole numbers within bounds."""
    if type(value) is bool or not isinstance(value, numbers.Integral):
        raise ValueError(f"{name} must be a whole number, not {value!r}")
    require_number(name, value, Bounds(ge=least, le=most))


def counted(number: int, noun: str) -> str:
    """A number of things in words, as in `1 bay` and `2 bays`."""
    return f"{number} {noun}{'s' * (number != 1)}"


def require_seed(seed: Any) -> None:
    """Refuses a seed that is negative, too large, or not a whole number."""
    require_count("seed", seed, 0, MAX_SEED)


def require_kind(name: str, value: object, kind: Any) -> None:
    """Refuses an argument, with a `TypeError`, that is not an instance of a type."""
    if not isinstance(value, kind):
        kinds = get_args(kind) or (kind,)
        names = ["None" if k is NoneType else k.__name__ for k in kinds]
        raise TypeError(
            f"{name} must be of {' or '.join(names)}, not {reprlib.repr(value)}"
        )


def require_unset(config: Any, where: str, *names: str) -> None:
    """Refuses attributes other than their defaults where they have no effect."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name in names and value != field.default:
            raise ValueError(
                f"{field.name} {value!r} has no effect {where}: leave it out"
            )


def data(default: Any, off: Any = None) -> Any:
    """A field of a config whose numbers only enter into arithmetic.

    Runs side by side may differ in it, see `carpark_mj.config.is_data`, except from
    `off`, the value that leaves something out of the program.
    """
    return dataclasses.field(default=default, metadata={"data": True, "off": off})


def is_off(value: Any, off: Any = 0.0) -> bool:
    """Whether a value is known to be `off`; a traced one may be any."""
    return isinstance(value, numbers.Real | tuple) and value == off


class CheckedConfig:
    """Base of configs: every field is of its declared type and within its `Bounds`.

    A config with checks of its own makes them after `super().__post_init__()`.
    """

    def __post_init__(self) -> None:
        require_types(self)
        require_bounds(self)


def require_bounds(config: Any) -> None:
    """Refuses attributes of a dataclass beyond the bounds that their types declare."""
    for name, (hint, bounds) in _bounded(type(config)).items():
        value = getattr(config, name)
        if value is None:
            continue
        rises = hint not in RANGES or value[0] <= value[1]
        if not (bounds.admit(value) and rises):
            order = "be a range (low, high) and " * (hint in RANGES)
            raise ValueError(f"{name} must {order}{bounds}, not {value!r}")


@functools.cache
def _bounded(cls: Any) -> dict[str, tuple[Any, Bounds]]:
    """Plain types and bounds of the fields of a dataclass that declare any."""
    found: dict[str, tuple[Any, Bounds]] = {}
    for name, hint in get_type_hints(cls, include_extras=True).items():
        for part in (hint, *get_args(hint)):  # `Annotated[...] | None`
            for bounds in getattr(part, "__metadata__", ()):
                if isinstance(bounds, Bounds):
                    found[name] = get_args(part)[0], bounds
    return found


def require_types(config: Any, **hints: Any) -> None:
    """Refuses attributes of a dataclass that are not of the types they declare.

    Truth values are not numbers, and lists are not tuples: JAX hashes configs as static
    arguments. `hints` are other types than those declared, by field.
    """
    for name, hint in (_declared(type(config)) | hints).items():
        require_type(name, getattr(config, name), hint)


def require_type(name: str, value: Any, hint: Any) -> None:
    """Refuses a value that is not of a declared type, see `require_types`."""
    if _is_of(value, hint):
        return
    choices = [x for x in (hint, *get_args(hint)) if get_origin(x) is Literal]
    if isinstance(value, str) and choices:
        require_choice(name, value, choices[0])
    raise ValueError(f"{name} must be {_describe(hint)}, not {reprlib.repr(value)}")


@functools.cache
def _declared(cls: Any) -> dict[str, Any]:
    """Types of the fields of a dataclass, by name."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in dataclasses.fields(cls)}


# Names of types, and other types that their values may have.
_NAMES = {
    bool: "True or False",
    int: "a whole number",
    float: "a number",
    str: "text",
    Callable: "a function",
    NoneType: "None",
}
_NUMBERS = {int: numbers.Integral, float: numbers.Real}


def _is_of(value: Any, hint: Any) -> bool:
    """Whether a value is of a declared type, items of tuples included."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return any(_is_of(value, part) for part in parts)
    if origin is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        items = parts[:1] * len(value) if parts[-1] is ... else parts
        return len(value) == len(items) and all(map(_is_of, value, items))
    if hint is float and isinstance(value, numbers.Integral) and not is_finite(value):
        return False  # Python does not convert it
    kind: Any = _NUMBERS.get(hint, origin or hint)
    return isinstance(value, kind) and (hint is bool or type(value) is not bool)


def _describe(hint: Any) -> str:
    """What a declared type allows."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(map(_describe, parts))
    if origin is Literal:
        return f"one of {sorted(parts)}"
    if origin is tuple:
        length = "" if parts[-1] is ... else f" of {len(parts)}"
        return f"a tuple{length}, each item {_describe(parts[0])}"
    return _NAMES.get(origin or hint, f"of {getattr(hint, '__name__', hint)}")


def is_finite(value: Any) -> bool:
    """Whether a value is a finite number, in float32 too."""
    if type(value) is bool or not isinstance(value, numbers.Real):
        return False
    number: Any = value
    return bool(abs(number) <= LARGEST)

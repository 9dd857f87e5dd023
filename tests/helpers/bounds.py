"""Values beyond what the fields of configs declare: bounds, choices and ranges."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin, get_type_hints

from carpark_mj.config.checks import RANGES, Bounds


def beyond_bounds(cls: Any) -> Iterator[tuple[str, Any]]:
    """Names of the bounded fields of a class, each with values that are outside."""
    hints = get_type_hints(cls, include_extras=True)
    for field in dataclasses.fields(cls):
        hint, whole = hints[field.name], field.default
        kinds = (hint, *get_args(hint))
        if Literal in map(get_origin, kinds):
            yield field.name, "no such choice"
        if isinstance(whole, tuple) and {*RANGES} & {*kinds}:
            low, high = whole
            yield field.name, (high + 1, low)
            yield field.name, (low, math.inf)
        for bounds in _bounds(hint):
            low, high = max(bounds.ge, bounds.gt), min(bounds.le, bounds.lt)
            for value in (low - 1, high + 1, bounds.gt, bounds.lt, math.nan):
                many = isinstance(whole, tuple)
                yield field.name, (value,) * max(len(whole), 1) if many else value


def _bounds(hint: Any) -> list[Bounds]:
    own = [x for x in getattr(hint, "__metadata__", ()) if isinstance(x, Bounds)]
    return own + [found for part in get_args(hint) for found in _bounds(part)]

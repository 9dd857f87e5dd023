"""Layouts of lots and the families of generators that make them.

Families are imported when they are used.
"""

import importlib
from typing import Any

from carpark_mj.layouts.registry import (
    layout_config,
    make_layout,
    member_shares,
    mixture,
)
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import (
    ROWS,
    BayEnd,
    BayKind,
    DiscKind,
    Layout,
    Maxima,
    WallKind,
    layout_maxima,
    pad_layout,
)

_HOMES = {
    "AngledConfig": "angled",
    "COMPACT": "square",
    "DeadEndConfig": "dead_end",
    "FromFileConfig": "from_file",
    "GarageRowConfig": "garage_row",
    "LotConfig": "lot",
    "MixtureConfig": "mixture_config",
    "SQUARE": "square",
    "SquareConfig": "square",
    "StreetConfig": "street",
    "StreetParallelConfig": "street",
}

__all__ = [  # pyright: ignore[reportUnsupportedDunderAll]
    "ROWS",
    "BayEnd",
    "BayKind",
    "DesignCar",
    "DiscKind",
    "Layout",
    "Maxima",
    "WallKind",
    "layout_config",
    "layout_maxima",
    "make_layout",
    "member_shares",
    "mixture",
    "pad_layout",
    *_HOMES,
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)

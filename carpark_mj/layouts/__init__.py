"""Layouts of lots and the families of generators that make them.

Families are imported when they are used.
"""

import importlib
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from carpark_mj.layouts.angled import AngledConfig
    from carpark_mj.layouts.car_park import CarParkConfig
    from carpark_mj.layouts.dead_end import DeadEndConfig
    from carpark_mj.layouts.from_file import FromFileConfig
    from carpark_mj.layouts.garage_row import GarageRowConfig
    from carpark_mj.layouts.lot import LotConfig
    from carpark_mj.layouts.mixture_config import MixtureConfig
    from carpark_mj.layouts.square import SQUARE, SQUARE_COMPACT, SquareConfig
    from carpark_mj.layouts.street import StreetConfig, StreetParallelConfig
else:
    _HOMES = {
        "AngledConfig": "angled",
        "CarParkConfig": "car_park",
        "DeadEndConfig": "dead_end",
        "FromFileConfig": "from_file",
        "GarageRowConfig": "garage_row",
        "LotConfig": "lot",
        "MixtureConfig": "mixture_config",
        "SQUARE": "square",
        "SQUARE_COMPACT": "square",
        "SquareConfig": "square",
        "StreetConfig": "street",
        "StreetParallelConfig": "street",
    }

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


__all__ = [
    "ROWS",
    "SQUARE",
    "SQUARE_COMPACT",
    "AngledConfig",
    "BayEnd",
    "BayKind",
    "CarParkConfig",
    "DeadEndConfig",
    "DesignCar",
    "DiscKind",
    "FromFileConfig",
    "GarageRowConfig",
    "Layout",
    "LotConfig",
    "Maxima",
    "MixtureConfig",
    "SquareConfig",
    "StreetConfig",
    "StreetParallelConfig",
    "WallKind",
    "layout_config",
    "layout_maxima",
    "make_layout",
    "member_shares",
    "mixture",
    "pad_layout",
]

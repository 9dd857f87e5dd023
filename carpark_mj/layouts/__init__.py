"""Layouts of lots and the families of generators that make them."""

from carpark_mj.layouts.car_park import CarParkConfig
from carpark_mj.layouts.clutter import ClutterConfig
from carpark_mj.layouts.files import FromFileConfig
from carpark_mj.layouts.lot import AngledConfig, LotConfig
from carpark_mj.layouts.registry import (
    MixtureConfig,
    layout_config,
    make_layout,
    member_shares,
    mixture,
)
from carpark_mj.layouts.schematics import (
    SQUARE_COMPACT,
    SquareConfig,
    StreetConfig,
    StreetParallelConfig,
)
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.stored import ScaledConfig, StoredConfig
from carpark_mj.layouts.tight import DeadEndConfig, GarageRowConfig
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

__all__ = [
    "ROWS",
    "SQUARE_COMPACT",
    "AngledConfig",
    "BayEnd",
    "BayKind",
    "CarParkConfig",
    "ClutterConfig",
    "DeadEndConfig",
    "DesignCar",
    "DiscKind",
    "FromFileConfig",
    "GarageRowConfig",
    "Layout",
    "LotConfig",
    "Maxima",
    "MixtureConfig",
    "ScaledConfig",
    "SquareConfig",
    "StoredConfig",
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

"""Layouts of lots and the families of generators that make them."""

from typing import TYPE_CHECKING

from carpark_mj.layouts.angled import AngledConfig
from carpark_mj.layouts.dead_end import DeadEndConfig
from carpark_mj.layouts.from_file import FromFileConfig
from carpark_mj.layouts.garage_row import GarageRowConfig
from carpark_mj.layouts.lot import LotConfig
from carpark_mj.layouts.mixture import MixtureConfig
from carpark_mj.layouts.registry import (
    layout_config,
    make_layout,
    member_shares,
    mixture,
)
from carpark_mj.layouts.square import SQUARE, SQUARE_COMPACT, SquareConfig
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.street import StreetConfig, StreetParallelConfig
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
from carpark_mj.renamed import old_names

if not TYPE_CHECKING:  # for which a module with this has every name
    __getattr__ = old_names(__name__)

__all__ = [
    "ROWS",
    "SQUARE",
    "SQUARE_COMPACT",
    "AngledConfig",
    "BayEnd",
    "BayKind",
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

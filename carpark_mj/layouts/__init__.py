"""Layouts of lots and the families of generators that make them."""

from carpark_mj.layouts.angled import AngledConfig
from carpark_mj.layouts.dead_end import DeadEndConfig
from carpark_mj.layouts.from_file import FromFileConfig
from carpark_mj.layouts.garage_row import GarageRowConfig
from carpark_mj.layouts.hope import HOPE, HopeConfig
from carpark_mj.layouts.lot_config import LotConfig
from carpark_mj.layouts.metadrive import MetaDriveConfig
from carpark_mj.layouts.mixture import MixtureConfig
from carpark_mj.layouts.registry import (
    FAMILIES,
    NAMED,
    SQUARES,
    generate,
    generate_member,
    layout_config,
    make_layout,
    member_shares,
    mixture,
)
from carpark_mj.layouts.slots import SlotsConfig
from carpark_mj.layouts.square import COMPACT, TANNER, SquareConfig, square
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.street import StreetConfig, StreetParallelConfig
from carpark_mj.layouts.tpcap_cases import TpcapConfig
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
    "COMPACT",
    "FAMILIES",
    "HOPE",
    "NAMED",
    "ROWS",
    "SQUARES",
    "TANNER",
    "AngledConfig",
    "BayEnd",
    "BayKind",
    "DeadEndConfig",
    "DesignCar",
    "DiscKind",
    "FromFileConfig",
    "GarageRowConfig",
    "HopeConfig",
    "Layout",
    "LotConfig",
    "Maxima",
    "MetaDriveConfig",
    "MixtureConfig",
    "SlotsConfig",
    "SquareConfig",
    "StreetConfig",
    "StreetParallelConfig",
    "TpcapConfig",
    "WallKind",
    "generate",
    "generate_member",
    "layout_config",
    "layout_maxima",
    "make_layout",
    "member_shares",
    "mixture",
    "pad_layout",
    "square",
]

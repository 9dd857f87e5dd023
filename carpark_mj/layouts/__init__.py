"""Layouts of lots and the families of generators that make them."""

# ruff: noqa: F403

import importlib
from typing import TYPE_CHECKING, Any

from carpark_mj.layouts.base import LAYOUTS
from carpark_mj.layouts.registry import layout_config as layout_config
from carpark_mj.layouts.registry import make_layout as make_layout
from carpark_mj.layouts.registry import member_shares as member_shares
from carpark_mj.layouts.registry import mixture as mixture
from carpark_mj.layouts.standards import DesignCar as DesignCar
from carpark_mj.layouts.types import ROWS as ROWS
from carpark_mj.layouts.types import BayEnd as BayEnd
from carpark_mj.layouts.types import BayKind as BayKind
from carpark_mj.layouts.types import DiscKind as DiscKind
from carpark_mj.layouts.types import Layout as Layout
from carpark_mj.layouts.types import Maxima as Maxima
from carpark_mj.layouts.types import WallKind as WallKind
from carpark_mj.layouts.types import layout_maxima as layout_maxima
from carpark_mj.layouts.types import pad_layout as pad_layout

if TYPE_CHECKING:
    from carpark_mj.layouts.car_park import *
    from carpark_mj.layouts.clutter import *
    from carpark_mj.layouts.files import *
    from carpark_mj.layouts.lot import *
    from carpark_mj.layouts.mixtures import *
    from carpark_mj.layouts.schematics import *
    from carpark_mj.layouts.stored import *
    from carpark_mj.layouts.tight import *


def __getattr__(name: str) -> Any:
    """The config of a family, which is imported when it is asked for."""
    for home in LAYOUTS.homes if name[0].isupper() else ():
        if hasattr(module := importlib.import_module(home), name):
            return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

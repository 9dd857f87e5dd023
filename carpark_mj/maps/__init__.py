"""Maps of real car parks, read into layouts; needs the extra `maps`.

A format (`lanelet2`, `openstreetmap`, `geojson`, `dxf`) becomes `features`: polygons
and lines in metres. `assemble` makes a layout of them, and a report of omitted ones.
"""

from collections.abc import Callable, Mapping
from typing import Any

from carpark_mj.extensions import Registry
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import Layout

# By a key at the top of their JSON files: readers, and the cars they are made for.
RecordedCase = tuple[Callable[[Mapping[str, Any]], Layout], DesignCar]
RECORDED_CASES: Registry[RecordedCase] = Registry("recorded case")

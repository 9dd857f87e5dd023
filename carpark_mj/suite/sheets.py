"""Cars by data sheet that no fleet of ours has: what a user would type in.

From public data sheets, quoted from memory and rounded as printed: lengths, widths
without mirrors, wheelbases, kerb masses, turning circles from kerb to kerb and driven
axles. [est] marks estimates; `carpark_mj.vehicle.sheet` estimates what is missing.
"""

import functools
from collections.abc import Mapping
from typing import Any

from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.sheet import car_of_sheet

_COLUMNS = ("length", "width", "height", "wheelbase", "turning_circle", "kerb_weight")
# Maker and model, drive and columns [m, kg].
_ROWS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "Smart fortwo (C453)": ("rear", (2.695, 1.663, 1.555, 1.873, 6.95, 900.0)),
    "Suzuki Alto (HA36)": ("front", (3.395, 1.475, 1.500, 2.460, 8.4, 620.0)),
    "Renault Twingo (III)": ("rear", (3.595, 1.646, 1.554, 2.492, 8.6, 940.0)),
    "Mazda MX-5 (ND)": ("rear", (3.915, 1.735, 1.230, 2.310, 9.4, 1050.0)),
    "VW Polo (VI)": ("front", (4.053, 1.751, 1.461, 2.548, 10.6, 1105.0)),
    "VW ID.4": ("rear", (4.584, 1.852, 1.640, 2.771, 10.2, 2124.0)),
    "Tesla Model 3": ("rear", (4.694, 1.849, 1.443, 2.875, 11.6, 1750.0)),
    "Skoda Superb (III)": ("front", (4.869, 1.864, 1.469, 2.841, 11.1, 1485.0)),
    # Its rear axle steers by up to 10 degrees.
    "Mercedes S-Class, long": ("rear", (5.289, 1.921, 1.503, 3.216, 10.9, 2070.0)),
    "Ford F-150 SuperCrew": ("rear", (5.890, 2.030, 1.961, 3.693, 14.6, 2150.0)),
    "Ford Transit L3H2": ("front", (5.981, 2.059, 2.550, 3.750, 13.3, 2000.0)),
    "Mercedes Sprinter L3H2": ("rear", (6.967, 2.020, 2.620, 4.325, 15.3, 2250.0)),
}
_MORE: Mapping[str, Mapping[str, Any]] = {
    "Mercedes S-Class, long": {"rear_steering": "10 deg"},
}
NAMES = tuple(_ROWS)


@functools.cache
def read_sheets() -> Mapping[str, VehicleParameters]:
    """The cars by maker and model, from the shortest to the longest."""
    cars: dict[str, VehicleParameters] = {}
    for name, (drive, row) in _ROWS.items():
        sheet: dict[str, Any] = {
            "drive": drive,
            **dict(zip(_COLUMNS, row, strict=True)),
        }
        sheet["wheel_radius"] = 0.24 + 0.016 * row[0]  # [est]
        sheet["tyre_width"] = 0.14 + 0.013 * row[0]  # [est]
        cars[name] = car_of_sheet({**sheet, **_MORE.get(name, {})}).params
    return cars

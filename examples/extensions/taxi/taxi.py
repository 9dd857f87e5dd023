"""A car: longer, heavier and less agile than `compact`."""

import dataclasses

from carpark_mj.vehicle import COMPACT, register_vehicle

TAXI = register_vehicle(
    "taxi",
    dataclasses.replace(
        COMPACT, length=4.4, wheelbase=2.7, mass=1500.0, turning_circle=11.2
    ),
)

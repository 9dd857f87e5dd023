"""highway-env's car, a box on the chassis of `compact`.

Numbers are those of version 1.12, `vehicle/kinematics.py` and the ranges of
`envs/parking_env.py`; `highway` physics reads nothing else.
"""

import dataclasses
import math

from carpark_mj.vehicle import COMPACT, register_vehicle
from carpark_mj.vehicle.parameters import kerb_to_kerb

register_vehicle(
    "highway",
    dataclasses.replace(
        COMPACT,
        length=5.0,
        width=2.0,
        rear_overhang=(5.0 - COMPACT.wheelbase) / 2,
        turning_circle=kerb_to_kerb(
            COMPACT.wheelbase, COMPACT.track_width, COMPACT.tyre_width, math.pi / 4
        ),
        max_acceleration=5.0,
        max_deceleration=5.0,
        max_speed=40.0,
        max_reverse_speed=40.0,
        steering_rate=1000.0,  # at once
    ),
)

"""The car of TPCAP and of HOPE with their limits, on the chassis of `sedan_fwd`."""

import dataclasses

from carpark_mj.studies.tpcap.files import TPCAP_CAR
from carpark_mj.vehicle import PRESETS, register_vehicle
from carpark_mj.vehicle.parameters import kerb_to_kerb

_CHASSIS = PRESETS["sedan_fwd"]
register_vehicle(
    "tpcap",
    dataclasses.replace(
        _CHASSIS,
        length=TPCAP_CAR.length,
        width=TPCAP_CAR.width,
        wheelbase=TPCAP_CAR.wheelbase,
        rear_overhang=TPCAP_CAR.rear_overhang,
        turning_circle=kerb_to_kerb(
            TPCAP_CAR.wheelbase,
            _CHASSIS.track_width,
            _CHASSIS.tyre_width,
            TPCAP_CAR.max_steering,
        ),
        max_acceleration=1.0,
        max_speed=2.5,
        max_reverse_speed=2.5,
        steering_rate=0.5,
    ),
)

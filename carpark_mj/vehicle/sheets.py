"""Data sheets of shipped vehicles, with sources; `vehicle.sheet` estimates the rest.

[press] as quoted by motor1 (ID.3), autocar (ID.3; S-Class, whose steered rear axle
takes 2 m from the turning circle), more8x (ID.3, kerb mass), newatlas and topgear
(Ranger), benzclub and autoevolution (S-Class), dieselnews (Canter 515 Super Low City
Cab) and krafthand (Canter's wheelbases); [est] our estimate or common knowledge, not
looked up. Masses include a driver.
"""

from types import MappingProxyType
from typing import Any

from carpark_mj.vehicle.presets import register_vehicle
from carpark_mj.vehicle.sheet import car_of_sheet

SHEETS: MappingProxyType[str, dict[str, Any]] = MappingProxyType(
    {
        # VW ID.3, 58 kWh.
        "electric": {
            "length": 4.261,  # [press]
            "width": 1.809,  # [press]
            "height": 1.568,  # [press]
            "wheelbase": 2.771,  # [press]
            "front_overhang": 0.845,  # [est]
            "mass": 1795.0,  # [press] 1719 kg and a driver
            "front_axle_load": 860.0,  # [est] 48 %
            "cg_height": 0.52,  # [est] the battery is in the floor
            "tyre_size": "215/55 R18",  # [est]
            "turning_circle": 10.2,  # [est]
            "drive": "rear",  # [press]
            "max_drive_torque": 3500.0,  # 310 N m x 11.5 [est]
            "max_power": 150e3,  # [press] 204 hp
            "drive_lag": 0.05,  # [est] a motor
        },
        # Mercedes-Benz S-Class (W223), long.
        "limousine": {
            "length": 5.289,  # [press]
            "width": 1.921,  # [press]
            "height": 1.503,  # [press]
            "wheelbase": 3.216,  # [press]
            "front_overhang": 0.88,  # [est]
            "mass": 2050.0,  # [est]
            "front_axle_load": 1050.0,  # [est] 51 %
            "cg_height": 0.56,  # [est]
            "tyre_size": "255/50 R18",  # [est]
            "turning_circle": 12.9,  # 10.9 [est] and the 2 m [press]
            "drive": "rear",  # [press] of the S 350 d
            "max_power": 210e3,  # [est]
        },
        # Ford Ranger (T6), double cab.
        "pickup": {
            "length": 5.35,  # [press]
            "width": 1.85,  # [press]
            "height": 1.85,  # [press]
            "wheelbase": 3.221,  # [press]
            "front_overhang": 0.905,  # [est]
            "mass": 2158.0,  # [press] 2083 kg and a driver
            "front_axle_load": 1230.0,  # [est] 57 %, empty
            "cg_height": 0.72,  # [est]
            "tyre_size": "265/65 R17",  # [est]
            "track_width": 1.56,  # [est]
            "turning_circle": 12.8,  # [press] 42 ft
            "drive": "rear",  # [press]
            "max_power": 110e3,  # [est]
        },
        # VW Crafter (2017), medium wheelbase, standard roof.
        "minibus": {
            "length": 5.986,  # [est]
            "width": 2.04,  # [est]
            "height": 2.355,  # [est]
            "wheelbase": 3.64,  # [est]
            "front_overhang": 0.996,  # [est]
            "mass": 2700.0,  # [est] with seats and a driver
            "front_axle_load": 1490.0,  # [est] 55 %
            "cg_height": 0.85,  # [est]
            "tyre_size": "205/75 R16 C",  # [est]
            "track_width": 1.75,  # [est]
            "turning_circle": 13.6,  # [est]
            "drive": "front",  # [press] whatvan
            "max_power": 103e3,  # [press] kleinezeitung, 140 hp
        },
        # Fuso Canter 515 Super Low City Cab with a low body.
        "truck": {
            "length": 4.85,  # [est]
            "width": 1.77,  # [est] cab 1.695, body and rear wheels wider
            "height": 2.01,  # [press]
            "wheelbase": 2.5,  # [press]
            "front_overhang": 1.045,  # [est]
            "mass": 2450.0,  # [est] with an empty body and a driver
            "front_axle_load": 1450.0,  # [est] 59 %
            "cg_height": 0.8,  # [est]
            "tyre_size": "195/75 R16 C",  # [est]
            "track_width": 1.4,  # [est]
            "turning_circle": 9.8,  # [est]
            "drive": "rear",  # [est]
            "max_power": 110e3,  # [press]
        },
    }
)
for name, quantities in SHEETS.items():
    register_vehicle(name, car_of_sheet(quantities).params)

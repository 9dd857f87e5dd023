"""Vehicle presets, each number with its source.

[press] manufacturer's data as quoted by motor1 and motor-car.net (Fiat), VW's press
release and stuff.co.nz (Golf), Wikipedia (BMW), autoreviewers and
chicagonow (Camry), laketahoenews (RAV4) and motorblock (T6); [circle] published
kerb-to-kerb circle: carspecslab (Fiat 9.0 to 9.7), 10.9 to 11.1 (Golf), Chrono (E90,
about 11.0), laketahoenews (RAV4, 36.7 ft); [ch] Project Chrono's BMW E90; [fiat]
published weight distribution of 62 % front; [od] openpilot's scaling rule I_zz =
0.2346 m L^2, with I_yy about 0.97 of it and I_xx scaled from [ch]; [est] our estimate
or common knowledge, not looked up.

Masses include a driver. Torque in first gear and power are those of a common engine of
the car; neither limits it at parking speeds. Suspension rates give a ride frequency
of 1.2 to 1.5 Hz and a damping ratio near 0.35, both [est]; `compact` keeps the
defaults, on which published policies were trained.

`SHEETS` are data sheets of more vehicles, whose other parameters are estimated: [press]
as quoted by motor1 (ID.3), autocar (ID.3; S-Class, whose steered rear axle takes 2 m
from the turning circle), more8x (ID.3, kerb mass), newatlas and topgear (Ranger),
benzclub and autoevolution (S-Class), dieselnews (Canter 515 Super Low City Cab) and
krafthand (Canter's wheelbases).
"""

from types import MappingProxyType
from typing import Any

from carpark_mj.config.vehicles import READ, is_name
from carpark_mj.extensions import Registry
from carpark_mj.vehicle.parameters import TyreParameters, VehicleParameters
from carpark_mj.vehicle.sheet import car_of_sheet

VEHICLES: Registry[VehicleParameters] = Registry("vehicle")


def register_vehicle(name: str, params: VehicleParameters) -> VehicleParameters:
    """Names a car for `EnvConfig.vehicle`, fleets and flags."""
    return VEHICLES.register(name, params)


def preset(name: str) -> VehicleParameters:
    """The vehicle of a name, or of a file (`carpark_mj.vehicle.sheet`)."""
    return VEHICLES[name] if is_name(name) else READ.load()(name)[1]


# Fiat 500 (2007), front-driven.
CITY = VehicleParameters(
    length=3.546,  # [press]
    width=1.627,  # [press]
    height=1.488,  # [press]
    wheelbase=2.300,  # [press]
    track_width=1.41,  # [est]
    rear_overhang=0.576,  # [est]
    mass=1000.0,  # [est] kerb mass of 865 to 980 kg [press] and a driver
    cg_to_front_axle=0.87,  # [fiat]
    cg_height=0.53,  # [est]
    roll_inertia=310.0,  # [od]
    pitch_inertia=1200.0,  # [od]
    yaw_inertia=1240.0,  # [od]
    wheel_radius=0.293,  # [est] 185/55 R15
    tyre_width=0.185,  # [est]
    turning_circle=9.3,  # [circle]
    front_drive=1.0,  # [press]
    max_drive_torque=1350.0,  # [est] 102 N m x 13.4
    max_power=51e3,  # [est]
    wheel_mass=15.0,  # [est]
    wheel_inertia=0.7,  # [est]
    wheel_tilt_inertia=0.42,  # [est]
    knuckle_mass=8.0,  # [est]
    tyre=TyreParameters(vertical_stiffness=21_000.0, vertical_damping=1600.0),  # [est]
)

# VW Golf VII, front-driven: the car of all published policies.
COMPACT = VehicleParameters(
    length=4.255,  # [press]
    width=1.799,  # [press]
    height=1.452,  # [press]
    wheelbase=2.637,  # [press]
    track_width=1.54,  # [est]
    rear_overhang=0.76,  # [est]
    mass=1380.0,  # [est]
    cg_to_front_axle=1.05,  # [est]
    cg_height=0.54,  # [est]
    roll_inertia=510.0,  # [od]
    pitch_inertia=2180.0,  # [od]
    yaw_inertia=2250.0,  # [od]
    wheel_radius=0.316,  # [est] 205/55 R16
    tyre_width=0.205,  # [est]
    turning_circle=10.9,  # [circle]
    front_drive=1.0,  # [press]
    max_drive_torque=2600.0,  # 200 N m [press] x 13 [est]
    max_power=90e3,  # [press]
)

# BMW 320i (E90), rear-driven.
SEDAN = VehicleParameters(
    length=4.520,  # [press]
    width=1.817,  # [press]
    height=1.421,  # [est]
    wheelbase=2.760,  # [press]
    track_width=1.505,  # [est]
    rear_overhang=1.00,  # [est]
    mass=1560.0,  # [ch] chassis and wheels, rounded
    cg_to_front_axle=1.38,  # [est] half and half
    cg_height=0.53,  # [est]
    roll_inertia=572.0,  # [ch]
    pitch_inertia=2490.0,  # [ch]
    yaw_inertia=2790.0,  # [od]; [ch] 2768
    wheel_radius=0.318,  # [est]
    tyre_width=0.225,  # [est]
    turning_circle=11.0,  # [circle]
    front_drive=0.0,  # [est]
    max_drive_torque=3000.0,  # [est] 210 N m x 14.3
    max_power=125e3,  # [est]
    tyre=TyreParameters(vertical_stiffness=30_000.0, vertical_damping=2400.0),  # [est]
)

# Toyota Camry (XV50), front-driven.
SEDAN_FWD = VehicleParameters(
    length=4.805,  # [press]
    width=1.820,  # [press]
    height=1.470,  # [est]
    wheelbase=2.776,  # [press]
    track_width=1.58,  # [est]
    rear_overhang=1.06,  # [est]
    mass=1560.0,  # [est] kerb mass and a driver
    cg_to_front_axle=1.11,  # [est] 60 % front
    cg_height=0.56,  # [est]
    roll_inertia=606.0,  # [od]
    pitch_inertia=2735.0,  # [od]
    yaw_inertia=2820.0,  # [od]
    wheel_radius=0.335,  # [press] 215/55 R17
    tyre_width=0.215,  # [press]
    turning_circle=11.2,  # [est]
    front_drive=1.0,  # [est]
    max_drive_torque=2800.0,  # 231 N m [press] x 12 [est]
    max_power=133e3,  # [press] 178 hp
    tyre=TyreParameters(vertical_stiffness=30_000.0, vertical_damping=2400.0),  # [est]
)

# Toyota RAV4 (2013 to 2018), all-wheel drive.
SUV = VehicleParameters(
    length=4.570,  # [press]
    width=1.845,  # [press]
    height=1.660,  # [est]
    wheelbase=2.659,  # [press]
    track_width=1.56,  # [press]
    rear_overhang=0.99,  # [est]
    mass=1700.0,  # [press] 1637 kg and a driver
    cg_to_front_axle=1.12,  # [est] 58 % front
    cg_height=0.65,  # [est]
    roll_inertia=645.0,  # [od]
    pitch_inertia=2735.0,  # [od]
    yaw_inertia=2820.0,  # [od]
    wheel_radius=0.362,  # [est] 225/65 R17
    tyre_width=0.225,  # [est]
    turning_circle=11.2,  # [circle]
    front_drive=0.5,  # [est] on-demand coupling closed, as it is when pulling away
    max_drive_torque=2900.0,  # [est] 233 N m x 12.5
    max_power=131e3,  # [est]
    wheel_mass=24.0,  # [est]
    wheel_inertia=1.6,  # [est]
    wheel_tilt_inertia=0.95,  # [est]
    knuckle_mass=12.0,  # [est]
    tyre=TyreParameters(vertical_stiffness=33_000.0, vertical_damping=2600.0),  # [est]
)

# VW Transporter T6, short wheelbase, front-driven.
VAN = VehicleParameters(
    length=4.904,  # [press]
    width=1.904,  # [press]
    height=1.970,  # [est]
    wheelbase=3.000,  # [press]
    track_width=1.63,  # [est]
    rear_overhang=0.99,  # [est]
    mass=2050.0,  # [est]
    cg_to_front_axle=1.35,  # [est] 55 % front, empty
    cg_height=0.75,  # [est]
    roll_inertia=845.0,  # [od]
    pitch_inertia=4200.0,  # [od]
    yaw_inertia=4330.0,  # [od]
    wheel_radius=0.340,  # [est] 215/65 R16 C
    tyre_width=0.215,  # [est]
    turning_circle=11.9,  # [est]
    front_drive=1.0,  # [est]
    max_drive_torque=4900.0,  # [est] 340 N m x 14.5
    max_power=110e3,  # [est]
    wheel_mass=24.0,  # [est]
    wheel_inertia=1.4,  # [est]
    wheel_tilt_inertia=0.85,  # [est]
    knuckle_mass=13.0,  # [est]
    tyre=TyreParameters(vertical_stiffness=38_000.0, vertical_damping=2900.0),  # [est]
)

# Cars with their own looks, to which estimates are fitted. Cars of data sheets, papers
# and other packages are registered too.
PRESETS = MappingProxyType(
    dict(city=CITY, compact=COMPACT, sedan=SEDAN, sedan_fwd=SEDAN_FWD, suv=SUV, van=VAN)
)
for name, params in PRESETS.items():
    register_vehicle(name, params)


_COLUMNS = (
    *("length", "width", "height", "wheelbase", "front_overhang"),
    *("mass", "front_axle_load", "cg_height", "turning_circle", "max_power"),
)
# Numbers are [press] but for those that comments name, which are [est].
_ROWS: dict[str, tuple[tuple[float, ...], dict[str, Any]]] = {
    # VW ID.3, 58 kWh. Overhang, axle load (48 %), the centre of gravity of a car with
    # its battery in the floor, tyres, circle, gear (11.5 times 310 N m) and lag.
    "electric": (
        (4.261, 1.809, 1.568, 2.771, 0.845, 1795.0, 860.0, 0.52, 10.2, 150e3),
        {"tyre_size": "215/55 R18", "drive": "rear"}
        | {"max_drive_torque": 3500.0, "drive_lag": 0.05},
    ),
    # Mercedes-Benz S-Class (W223), long. Overhang, mass, axle load (51 %), centre of
    # gravity, tyres, power, and the circle of 10.9 m to which 2 m are added.
    "limousine": (
        (5.289, 1.921, 1.503, 3.216, 0.88, 2050.0, 1050.0, 0.56, 12.9, 210e3),
        {"tyre_size": "255/50 R18", "drive": "rear"},
    ),
    # Ford Ranger (T6), double cab. Overhang, axle load (57 %, empty), centre of
    # gravity, tyres, track and power.
    "pickup": (
        (5.35, 1.85, 1.85, 3.221, 0.905, 2158.0, 1230.0, 0.72, 12.8, 110e3),
        {"tyre_size": "265/65 R17", "drive": "rear", "track_width": 1.56},
    ),
    # VW Crafter (2017), medium wheelbase, standard roof, with seats; all but the drive
    # (whatvan) and power (kleinezeitung).
    "minibus": (
        (5.986, 2.04, 2.355, 3.64, 0.996, 2700.0, 1490.0, 0.85, 13.6, 103e3),
        {"tyre_size": "205/75 R16 C", "drive": "front", "track_width": 1.75},
    ),
    # Fuso Canter 515 Super Low City Cab with a low, empty body; all but height,
    # wheelbase and power. Body and rear wheels are wider than the cab of 1.695 m.
    "truck": (
        (4.85, 1.77, 2.01, 2.5, 1.045, 2450.0, 1450.0, 0.8, 9.8, 110e3),
        {"tyre_size": "195/75 R16 C", "drive": "rear", "track_width": 1.4},
    ),
}
SHEETS: MappingProxyType[str, dict[str, Any]] = MappingProxyType(
    {name: dict(zip(_COLUMNS, x, strict=True)) | y for name, (x, y) in _ROWS.items()}
)
for name, quantities in SHEETS.items():
    register_vehicle(name, car_of_sheet(quantities).params)

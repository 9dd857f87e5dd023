"""Levels of whole lots in which a car parks alone: others' lots, and others' cars.

- `metadrive`: MetaDrive's lot; the car drives in to a space or out of one to an exit.
- `san_jose`, `dragon_lake`: parts of real car parks among parked cars.
- `sheets`: twelve cars by data sheet in turn, what a user would type in, in lots of
  `anywhere` from the test split. Where a car is longer than their bays, all of a lot is
  enlarged until it fits.

Starts, goals and parked cars of a case follow from its number.

Sheets are public, quoted from memory and rounded as printed: lengths, widths without
mirrors, wheelbases, kerb masses, turning circles from kerb to kerb and driven axles.
[est] marks estimates; `carpark_mj.vehicle.sheet` estimates what is missing.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, FleetConfig, LayoutConfig
from carpark_mj.layouts import layout_config
from carpark_mj.layouts.car_park import random_parts
from carpark_mj.layouts.mixtures import MixtureConfig
from carpark_mj.layouts.registry import TEST, lot_key
from carpark_mj.layouts.standards import BAY_LENGTH
from carpark_mj.layouts.stored import ScaledConfig
from carpark_mj.layouts.types import Layout, enlarge
from carpark_mj.registry import ANYWHERE
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite.levels import LEVELS, CaseLevel, Cases, CaseStart
from carpark_mj.suite.metadrive import MetaDriveConfig
from carpark_mj.suite.tpcap import stack_layouts
from carpark_mj.vehicle import VehicleParameters
from carpark_mj.vehicle.presets import usual_wheels
from carpark_mj.vehicle.sheet import car_of_sheet, parameters_text

VERSION = 1
CASES = 1000  # a level
FIRST = TEST.start + 10_000  # lot of the first case; HOPE's levels have those before
PARTS, PART = 12, (60.0, 45.0)  # of a car park, and its size [m]
PARKED = {"san_jose": 12, "dragon_lake": 20}  # cars; the parts have 16 and 72 bays
ROOM = 0.3  # m that the shortest bay is longer than a car
SHEETS = "sheets"


def lots_level(
    name: str,
    draw: Callable[[np.ndarray], Layout],
    env: Callable[[EnvConfig], EnvConfig],
    cars: Sequence[str] = (),
) -> CaseLevel:
    """A level of whole lots; `draw` makes those (n, ...) of the numbers (n,) of cases.

    `cars` are the names of its fleet's, which cases have in turn; empty = the suite's.
    """

    def pick(which: slice) -> Cases:
        number = np.arange(CASES)[which]
        keys = jax.vmap(jax.random.key)(number)
        kind = number % max(len(cars), 1)
        options = ResetOptions(kind=jnp.int32(kind[:, None]) if cars else None)
        kinds = np.array(cars)[kind] if cars else np.full(len(number), "drawn")
        return Cases(name, number, kinds, draw(number), CaseStart(keys, options, ()))

    told = f"{name} {VERSION}"
    sha256 = hashlib.sha256(told.encode()).hexdigest()
    return CaseLevel(range(CASES), sha256, pick, env, f"Lots of {told}")


def _in_turn(name: str, members: Callable[[], Sequence[LayoutConfig]]) -> CaseLevel:
    """Of fixed lots in turn."""

    def draw(number: np.ndarray) -> Layout:
        rows = number % len(members())
        lots = stack_layouts([jax.device_get(lot.layout) for lot in members()])
        return jax.tree.map(lambda x: x[rows], lots)

    def env(env: EnvConfig) -> EnvConfig:
        # As a fleet, the car drives only to bays that it fits in.
        agents = (env.vehicle,) if env.observation.own_car else ()
        return dataclasses.replace(
            env,
            layout=MixtureConfig(tuple(members())),
            num_parked_cars=PARKED[name],
            fleet=FleetConfig(agents=agents, parked_cars=("compact",)),
        )

    return lots_level(name, draw, env)


for _name in PARKED:
    _parts = functools.cache(functools.partial(random_parts, _name, PART, PARTS))
    LEVELS.register(_name, _in_turn(_name, _parts))


def _metadrive(number: np.ndarray) -> Layout:
    lot = jax.device_get(MetaDriveConfig().generate(jax.random.key(0)))
    return jax.tree.map(lambda x: np.broadcast_to(x, (len(number), *x.shape)), lot)


def _metadrive_env(env: EnvConfig) -> EnvConfig:
    goals = dataclasses.replace(env.goals, drive_out=True)
    return dataclasses.replace(env, layout=MetaDriveConfig(), goals=goals)


LEVELS.register("metadrive", lots_level("metadrive", _metadrive, _metadrive_env))


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
_MORE = {"Mercedes S-Class, long": {"rear_steering": "10 deg"}}
NAMES = tuple(_ROWS)


@functools.cache
def read_sheets() -> Mapping[str, VehicleParameters]:
    """The cars by maker and model, from the shortest to the longest."""
    cars: dict[str, VehicleParameters] = {}
    for name, (drive, row) in _ROWS.items():
        sheet = {"drive": drive, **dict(zip(_COLUMNS, row, strict=True))}
        sheet |= usual_wheels(row[0]) | _MORE.get(name, {})
        cars[name] = car_of_sheet(sheet).params
    return cars


def factor_for(car: VehicleParameters) -> float:
    """How much larger than usual lots are whose shortest bay has room for a car."""
    return max((car.length + ROOM) / BAY_LENGTH[0], 1.0)


@jax.jit
def _enlarged(number: jax.Array, factor: jax.Array) -> Layout:
    lots = layout_config(ANYWHERE.layout)
    draw = jax.vmap(lambda n, x: enlarge(lots.generate(lot_key(n)), x))
    return draw(number, factor)


def _sheet_lots(number: np.ndarray) -> Layout:
    factors = np.array([*map(factor_for, read_sheets().values())], np.float32)
    lots = (FIRST + number).astype(np.uint32)
    return _enlarged(lots, factors[number % len(factors)])


def _sheets_env(env: EnvConfig) -> EnvConfig:
    cars = tuple(parameters_text(*car) for car in read_sheets().items())
    largest = max(map(factor_for, read_sheets().values()))
    return dataclasses.replace(
        env,
        layout=ScaledConfig(layout_config(ANYWHERE.layout), (largest, largest)),
        num_parked_cars=ANYWHERE.num_parked_cars,
        occupancy=ANYWHERE.occupancy,
        fleet=FleetConfig(agents=cars, parked_cars=ANYWHERE.fleet.parked_cars),
        jitter=ANYWHERE.jitter,
    )


LEVELS.register(SHEETS, lots_level(SHEETS, _sheet_lots, _sheets_env, NAMES))

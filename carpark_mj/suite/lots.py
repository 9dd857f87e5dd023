"""Levels of whole lots in which a car parks alone: others' lots, and others' cars.

- `metadrive`: MetaDrive's lot; the car drives in to a space or out of one to an exit.
- `san_jose`, `dragon_lake`: parts of real car parks among parked cars.
- `sheets`: twelve cars by data sheet in turn (`carpark_mj.suite.sheets`), in lots of
  `anywhere` from the test split. Where a car is longer than their bays, all of a lot is
  enlarged until it fits.

Starts, goals and parked cars of a case follow from its number.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, FleetConfig, LayoutConfig
from carpark_mj.layouts import layout_config
from carpark_mj.layouts.car_park import random_parts
from carpark_mj.layouts.registry import TEST, MixtureConfig, lot_key
from carpark_mj.layouts.standards import BAY_LENGTH
from carpark_mj.layouts.stored import ScaledConfig
from carpark_mj.layouts.types import Layout, enlarge
from carpark_mj.registry import ANYWHERE
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite.levels import EXTRA_LEVELS, CaseLevel, Cases, CaseStart
from carpark_mj.suite.metadrive import MetaDriveConfig
from carpark_mj.suite.sheets import NAMES, read_sheets
from carpark_mj.suite.tpcap import stack_layouts
from carpark_mj.vehicle import VehicleParameters
from carpark_mj.vehicle.sheet import parameters_text

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
    """A level of whole lots.

    Args:
        name: of the level.
        draw: lots (n, ...) of the numbers (n,) of cases.
        env: its environment, from that of the suite.
        cars: names of its fleet's cars, which cases have in turn; empty = the suite's.
    """

    def pick(which: slice) -> Cases:
        number = np.arange(CASES)[which]
        keys = jax.vmap(jax.random.key)(number)
        kind = number % max(len(cars), 1)
        options = ResetOptions(
            kind=jnp.asarray(kind[:, None], jnp.int32) if cars else None
        )
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
        agents = (env.vehicle,) if env.observation.sees_own_car else ()
        return dataclasses.replace(
            env,
            layout=MixtureConfig(tuple(members())),
            num_parked_cars=PARKED[name],
            fleet=FleetConfig(agents=agents, parked_cars=("compact",)),
        )

    return lots_level(name, draw, env)


for _name in PARKED:
    _parts = functools.cache(functools.partial(random_parts, _name, PART, PARTS))
    EXTRA_LEVELS.register(_name, _in_turn(_name, _parts))


def _metadrive(number: np.ndarray) -> Layout:
    lot = jax.device_get(MetaDriveConfig().generate(jax.random.key(0)))
    return jax.tree.map(lambda x: np.broadcast_to(x, (len(number), *x.shape)), lot)


def _metadrive_env(env: EnvConfig) -> EnvConfig:
    goals = dataclasses.replace(env.goals, drive_out=True)
    return dataclasses.replace(env, layout=MetaDriveConfig(), goals=goals)


EXTRA_LEVELS.register("metadrive", lots_level("metadrive", _metadrive, _metadrive_env))


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


EXTRA_LEVELS.register(SHEETS, lots_level(SHEETS, _sheet_lots, _sheets_env, NAMES))

"""Refuses cars that cannot drive or park in a lot, and more than it has room for."""

import math
from collections.abc import Sequence

import jax
import numpy as np

from carpark_mj.config import PARKED_RULES, EnvConfig, LayoutConfig
from carpark_mj.config.checks import Range
from carpark_mj.fleet.draw import Fleet
from carpark_mj.layouts import Layout, MixtureConfig, make_layout
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.turning import Entry
from carpark_mj.layouts.types import BayKind
from carpark_mj.vehicle import VehicleParameters

SAMPLED_LOTS = 4  # in which a random lot's bays are measured against the fleet


def check_room(config: EnvConfig, lot: LayoutConfig) -> None:
    """Refuses more cars or tracked bays than the lot has bays for.

    Raises:
        ValueError: naming the number and the most there can be.
    """
    bays, agents = lot.min_bays, _num_goals(config)
    if config.goals.dynamic:
        free = bays - config.num_parked_cars
        if free < config.goals.num_tracked_bays:
            raise ValueError(
                f"goals.num_tracked_bays must be at most {max(free, 0)} ({bays} bays "
                f"less {config.num_parked_cars} parked cars), not "
                f"{config.goals.num_tracked_bays}"
            )
        return
    if agents > lot.min_goals:
        name = "num_agents" if agents == config.num_agents else "min_agents"
        raise ValueError(
            f"{name} must be at most {lot.min_goals} (a goal bay each), not {agents}"
        )
    free = bays - agents
    if config.occupancy is None and config.num_parked_cars > free:
        raise ValueError(
            f"num_parked_cars must be at most {free} ({bays} bays less {agents} "
            f"agents' goals), not {config.num_parked_cars}"
        )


def check_exits(config: EnvConfig, lot: LayoutConfig) -> None:
    """Refuses cars that drive out where there are no exits, and exits for others.

    Args:
        config: of the environment.
        lot: its layout's config.

    Raises:
        ValueError: naming the setting.
    """
    if isinstance(lot, MixtureConfig):
        for member in lot.members:
            check_exits(config, member)
        return
    exits = has_exits(lot)
    if exits != config.goals.drive_out:
        have = "has exits: set" if exits else "has no exits: use metadrive, or leave"
        raise ValueError(
            f"the layout {have} goals.drive_out = {exits}, not {config.goals.drive_out}"
        )


def has_exits(lot: LayoutConfig) -> bool:
    """Whether cars can drive out of a lot; of a mixture, out of all its members."""
    if isinstance(lot, MixtureConfig):
        return all(map(has_exits, lot.members))
    if lot.is_random:  # random lots have none
        return False
    layout = make_layout(lot)
    return bool((layout.bay_mask & (layout.bay_kind == BayKind.EXIT)).any())


def check_occupancy(config: EnvConfig, lot: LayoutConfig) -> None:
    """Refuses fewer parked cars than `EnvConfig.occupancy` requires.

    Raises:
        ValueError: naming the number needed.
    """
    if config.occupancy is None:
        return
    needed = parked_cars_needed(config.occupancy, lot)
    if needed > config.num_parked_cars:
        raise ValueError(
            f"occupancy of up to {config.occupancy[1]:g} of {lot.min_bays} bays needs "
            f"num_parked_cars of at least {needed}, not {config.num_parked_cars}"
        )


def parked_cars_needed(occupancy: Range, lot: LayoutConfig) -> int:
    """How many parked cars an occupancy takes; of random lots, in the smallest."""
    return math.floor(occupancy[1] * lot.min_bays + 1e-6)


def check_cars(
    config: EnvConfig, fleet: Fleet, lot: LayoutConfig, layout: Layout | None
) -> None:
    """Refuses cars that cannot enter any bay from the aisle, or fit into none.

    On the grid cars turn on the spot, so only the fit is checked.

    Args:
        config: of the environment.
        fleet: its cars.
        lot: its layout's config.
        layout: its layout, None if that is random: then a few are drawn.

    Raises:
        ValueError: naming the car and what is allowed.
    """
    names = config.fleet.agents or (config.vehicle,)
    if config.physics != "grid":
        for name, params in zip(names, fleet.agents, strict=True):
            _require_entry(name, params, lot.entries)
    one_size = not config.fleet.is_on and config.jitter.scale == (1.0, 1.0)
    if not config.varies or (one_size and layout is None):
        return
    lots = [layout] if layout is not None else _sample(lot)
    bays = [np.asarray(x.bay_size)[np.asarray(x.bay_mask)] for x in lots]
    if fleet.mixed:
        rule = config.episode.parked_rule
        slack = PARKED_RULES[rule].slack
        counts = [
            _count_bays("fleet.agents", name, _size(params), slack, bays)
            for name, params in zip(names, fleet.agents, strict=True)
        ]
        goals = _num_goals(config)
        if layout is not None and max(counts) < goals:
            raise ValueError(
                f"fleet.agents find goals in only {max(counts)} bays of this lot under "
                f"the {rule} rule, fewer than the {goals} agents of a lot"
            )
    if config.num_parked_cars:
        names = config.fleet.parked_cars or (config.vehicle,)
        scale = config.jitter.scale[1]
        for name, params in zip(names, fleet.parked_cars, strict=True):
            _count_bays("parked cars", name, scale * _size(params), 0.0, bays)


def _num_goals(config: EnvConfig) -> int:
    """How many agents must have a goal in every lot."""
    if config.goals.dynamic:
        return 0
    # With an occupancy the bays are shared out: first come, first served.
    return config.num_agents if config.occupancy is None else config.agent_counts.start


def _size(params: VehicleParameters) -> np.ndarray:
    return np.array([params.length, params.width])


def _sample(lot: LayoutConfig) -> list[Layout]:
    keys = jax.random.split(jax.random.key(0), SAMPLED_LOTS)
    return [make_layout(lot, key) for key in keys]


def _require_entry(
    name: str, params: VehicleParameters, entries: Sequence[Entry]
) -> None:
    """Refuses a car that can enter no bay of a lot, as families refuse their own."""
    car = DesignCar(
        params.length,
        params.width,
        params.wheelbase,
        params.rear_overhang,
        params.max_steering,
    )
    if not entries or any(entry.least(car) <= entry.aisle for entry in entries):
        return
    entry = min(entries, key=lambda entry: entry.least(car) - entry.aisle)
    raise ValueError(
        f"the {name} needs an aisle of {entry.least(car):.2f} m to turn into a bay "
        f"{entry.bay_width:.2f} m wide (carpark_mj.layouts.turning), the lot's aisles "
        f"are up to {entry.aisle:.2f} m wide"
    )


def _count_bays(
    kind: str, name: str, size: np.ndarray, slack: float, lots: Sequence[np.ndarray]
) -> int:
    """In how many bays of the roomiest lot a car fits; refuses 0."""
    count = max(int((size + slack <= bays).all(axis=1).sum()) for bays in lots)
    if not count:
        longest, widest = np.concatenate(lots).max(axis=0)
        raise ValueError(
            f"{kind}: the {name}, {size[0]:.2f} m x {size[1]:.2f} m, fits with "
            f"{slack:g} m to spare in no bay of the lot: these are up to "
            f"{longest:.2f} m long and {widest:.2f} m wide"
        )
    return count

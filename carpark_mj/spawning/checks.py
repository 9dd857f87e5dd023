"""Refuses cars that cannot drive or park in a lot, and too many cars."""

import functools
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, LayoutConfig
from carpark_mj.config.checks import Range
from carpark_mj.geometry import to_world
from carpark_mj.geometry.obstacles import Boxes, Discs, touches
from carpark_mj.layouts import Layout, make_layout
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.standards import DesignCar, Entry
from carpark_mj.layouts.types import BayKind
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.vehicle import VehicleParameters

SAMPLED_LOTS = 4  # of each random family, whose bays are measured against the fleet


def check_numbers(config: EnvConfig, lot: LayoutConfig) -> None:
    """Refuses more cars or tracked bays than lots have bays for."""
    bays, agents, parked = lot.min_bays, _num_goals(config), config.num_parked_cars
    if config.occupancy is not None:
        needed = parked_cars_needed(config.occupancy, lot)
        if needed > parked:
            raise ValueError(
                f"occupancy of up to {config.occupancy[1]:g} of {bays} bays needs "
                f"num_parked_cars of at least {needed}, not {parked}"
            )
    if config.goals.dynamic:
        free = max(bays - parked, 0)
        if free < config.goals.num_tracked_bays:
            raise ValueError(
                f"goals.num_tracked_bays must be at most {free} ({bays} bays less "
                f"{parked} parked cars), not {config.goals.num_tracked_bays}"
            )
        return
    if agents > lot.min_goals:
        name = "num_agents" if agents == config.num_agents else "min_agents"
        raise ValueError(
            f"{name} must be at most {lot.min_goals} (a goal bay each), not {agents}"
        )
    if config.occupancy is None and parked > bays - agents:
        raise ValueError(
            f"num_parked_cars must be at most {bays - agents} ({bays} bays less "
            f"{agents} agents' goals), not {parked}"
        )


def check_exits(config: EnvConfig, lot: LayoutConfig) -> None:
    """Refuses `goals.drive_out` without exits, and exits without `goals.drive_out`."""
    wanted = config.goals.drive_out
    for exits in map(has_exits, lot.parts):
        if exits != wanted:
            have = "exits: set" if exits else "no exits: use metadrive, or leave"
            raise ValueError(
                f"the layout has {have} goals.drive_out = {exits}, not {wanted}"
            )


def has_exits(lot: LayoutConfig) -> bool:
    """Whether cars can drive out of a lot; of a mixture, out of all its members."""
    for part in lot.parts:
        if part.is_random:  # random lots have none
            return False
        layout = make_layout(part)
        kinds = np.asarray(layout.bay_kind)[np.asarray(layout.bay_mask)]
        if not (kinds == BayKind.EXIT).any():
            return False
    return True


def parked_cars_needed(occupancy: Range, lot: LayoutConfig) -> int:
    """Number of parked cars for an occupancy; for random lots, in the smallest."""
    return math.floor(occupancy[1] * lot.min_bays + 1e-6)


def check_cars(
    config: EnvConfig, fleet: Fleet, lot: LayoutConfig, layout: Layout | None
) -> None:
    """Refuses cars that cannot start, enter a bay from the aisle, or fit into one.

    A single kind of car must fit into all bays of a fixed lot, each car of a fleet into
    at least one. Cars that do not steer need no room to turn into a bay. Of random
    lots, `layout` None, some are drawn until each car has a bay.
    """
    agents = list(zip(fleet.agent_names, fleet.agents, strict=True))
    for name, car in agents:
        if config.physics_config.steers:
            _require_entry(name, car, lot.entries)
        if layout is not None:
            _require_start(name, car, lot, layout)
    one_size = not config.fleet.is_on and config.jitter.scale == (1.0, 1.0)
    if one_size and layout is None and is_made_for(lot, fleet.agents[0]):
        return

    def bays() -> Iterable[np.ndarray]:
        if layout is not None:
            return [_bays(layout)]
        # Family by family: each compiles a program, and the first often suffices.
        drawn = itertools.product(lot.parts, range(SAMPLED_LOTS))
        return itertools.starmap(_draw_bays, drawn)

    if fleet.mixed:
        slack, goals = config.episode.slack, _num_goals(config)
        most = max(
            _count_bays("fleet.agents", name, _size(car), slack, bays())
            for name, car in agents
        )
        if layout is not None and most < goals:
            raise ValueError(
                f"fleet.agents find goals in only {most} bays of this lot under the "
                f"{config.episode.parked_rule} rule, fewer than its {goals} agents"
            )
    else:  # drawn without regard to its size
        used = None if layout is None else _bays(layout)
        if layout is not None and (config.varies or not config.num_parked_cars):
            used = np.asarray(layout.bay_size)[np.asarray(layout.goal_mask)]
        [(name, car)] = agents
        lots = bays() if used is None else [used]
        count = _count_bays("agents", name, _size(car), 0.0, lots)
        if used is not None and count < len(used):
            raise ValueError(
                f"the {name}, {car.length:.2f} m x {car.width:.2f} m, fits in only "
                f"{count} of the lot's {len(used)} bays; fleet.agents and "
                "fleet.parked_cars take presets and use only bays that these fit in"
            )
    if config.num_parked_cars and config.varies:
        scale = config.jitter.scale[1]
        for name, car in zip(fleet.parked_names, fleet.parked_cars, strict=True):
            _count_bays("parked cars", name, scale * _size(car), 0.0, bays())


def _bays(layout: Layout) -> np.ndarray:
    """Length and width (bays, 2) of the bays that there are."""
    return np.asarray(layout.bay_size)[np.asarray(layout.bay_mask)]


@functools.lru_cache(maxsize=256)
def _draw_bays(part: LayoutConfig, number: int) -> np.ndarray:
    if not part.is_random:
        return _bays(make_layout(part))
    key = jax.random.fold_in(jax.random.key(0), number)
    size, mask = _bays_only(*part.split(), key)
    return np.asarray(size)[np.asarray(mask)]


@functools.partial(jax.jit, static_argnums=0)
def _bays_only(draw: Any, numbers: Any, key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sizes and mask of a lot's bays, by a far smaller program than a whole lot."""
    layout = draw(numbers, key)
    return layout.bay_size, layout.bay_mask


def _require_start(
    name: str, car: VehicleParameters, lot: LayoutConfig, layout: Layout
) -> None:
    """Refuses a car that touches an obstacle at every possible start."""
    if is_made_for(lot, car):
        return
    size = jnp.asarray(_size(car))
    for region in np.flatnonzero(layout.spawn_mask):
        if not _touches_everywhere(layout, region, size):
            return
    raise ValueError(
        f"the {name}, {car.length:.2f} m x {car.width:.2f} m, finds no start in "
        "the lot: it touches a wall or disc wherever it could spawn"
    )


@jax.jit
def _touches_everywhere(layout: Layout, region: int, size: jax.Array) -> jax.Array:
    """Whether a car of a size (2,) touches something all over a spawn region."""
    # Along, across and in heading, out to the bounds.
    shares = jnp.linspace(-1.0, 1.0, 9)
    shares = jnp.stack(jnp.meshgrid(shares, shares, shares), axis=-1).reshape(-1, 3)
    bounds = jnp.append(layout.spawn_size[region] / 2, layout.spawn_spread[region])
    starts = to_world(layout.spawn_pose[region], shares * bounds)
    walls = Boxes(layout.wall_pose, layout.wall_size, mask=layout.wall_mask)
    discs = Discs(layout.disc_centre, layout.disc_radius, mask=layout.disc_mask)
    return touches(starts, size, (walls, discs)).all()


def is_made_for(lot: LayoutConfig, car: VehicleParameters) -> bool:
    """Whether bays and spawn regions of all lots of a family have room for a car."""
    for part in lot.parts:
        if part.layout is not None:
            if describe_faults(part.layout, (car.length, car.width)):
                return False
            continue
        made_for = part.car or DesignCar()
        if car.length > made_for.length or car.width > made_for.width:
            return False
    return True


def _num_goals(config: EnvConfig) -> int:
    """How many agents must have a goal in every lot."""
    if config.goals.dynamic:
        return 0
    # With an occupancy, bays are assigned in order until none is left.
    return config.num_agents if config.occupancy is None else config.agent_counts.start


def _size(car: VehicleParameters) -> np.ndarray:
    return np.array([car.length, car.width], np.float32)  # as bays have theirs


def _require_entry(name: str, car: VehicleParameters, entries: Sequence[Entry]) -> None:
    """Refuses a car that cannot enter any bay of a lot, as families do."""
    design = DesignCar(
        car.length, car.width, car.wheelbase, car.rear_overhang, car.max_steering
    )
    if not entries or any(entry.least(design) <= entry.aisle for entry in entries):
        return
    entry = min(entries, key=lambda entry: entry.least(design) - entry.aisle)
    least, bay = entry.least(design), f"a bay {entry.bay_width:.2f} m wide"
    if math.isinf(least):
        raise ValueError(f"the {name}, {car.width:.2f} m wide, cannot turn into {bay}")
    raise ValueError(
        f"the {name} needs an aisle of {least:.2f} m to turn into {bay} "
        f"(carpark_mj.layouts.standards), the lot's aisles are up to "
        f"{entry.aisle:.2f} m wide"
    )


def _count_bays(
    kind: str, name: str, size: np.ndarray, slack: float, lots: Iterable[np.ndarray]
) -> int:
    """Number of bays that a car fits into in the first lot with any; refuses none."""
    seen: list[np.ndarray] = []
    for bays in lots:
        seen.append(bays)
        if count := int((size + slack <= bays).all(axis=1).sum()):
            return count
    longest, widest = np.concatenate(seen).max(axis=0)
    spare = f"with {slack:g} m to spare " if slack else ""
    raise ValueError(
        f"{kind}: the {name}, {size[0]:.2f} m x {size[1]:.2f} m, fits {spare}in no bay "
        f"of the lot: these are up to {longest:.2f} m long and {widest:.2f} m wide"
    )

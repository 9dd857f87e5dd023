"""Compares the pixels of cameras with MuJoCo's rays, in every family of layouts.

python eval/cameras.py
python eval/cameras.py --layouts lot angled --lots 4

Casts the rays of all pixels in MuJoCo, at cars as the two blocks that cameras see and
as meshes. Exit code 1: too few pixels agree.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("cameras", "cameras:main")

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from camera_reference import Reference
from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.cameras import RIGS, Heights, see
from carpark_mj.config import LAYOUTS, GoalConfig, SpawnConfig
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.evaluation.tables import markdown
from carpark_mj.layouts import BayKind, layout_config, make_layout
from carpark_mj.types import State
from shell import command

AT_RANDOM = SpawnConfig(close_ratio=0.0, conflict_ratio=0.0, reverse_ratio=0.0)
AGENTS, PARKED_CARS = 2, 8
MOVERS = "pedestrians:number=3", "cart"


def families() -> list[str]:
    """A layout of every family, and all layouts unlike any other."""
    first: dict[str, str] = {}
    for name in LAYOUTS:
        first.setdefault(LAYOUTS[name].family, name)
    return sorted(first.values())


def environment(layout: str) -> ParkingEnv:
    """An environment with at most as many cars as bays.

    In lots with exits agents drive out and no car is parked.
    """
    lot = layout_config(layout)
    kinds = make_layout(lot, jax.random.key(0)).bay_kind
    exits = bool((kinds == BayKind.EXIT).any())
    agents = min(AGENTS, lot.min_goals)
    config = EnvConfig(
        layout=layout,
        num_agents=agents,
        num_parked_cars=0 if exits else min(PARKED_CARS, lot.min_bays - agents),
        goals=GoalConfig(drive_out=exits),
        spawn=AT_RANDOM if exits else SpawnConfig(),
        movers=MOVERS,
    )
    return ParkingEnv(config)


CLOSE = 0.01  # m, of depths that agree
ENOUGH = 0.998  # share of the pixels


class Agreement(NamedTuple):
    """Number of pixels, and shares of them that agree with MuJoCo's rays."""

    pixels: int
    depth: float
    classes: float
    meshes: float = 0.0  # with the class that rays at meshes find


def compare(env: ParkingEnv, states: Sequence[State], meshes: bool = True) -> Agreement:
    """Compares the images of all agents of some lots."""
    heights, shares, pixels = Heights.of(env.fleet), [], 0
    pictures_of = jax.jit(see, static_argnums=(0, 2))
    for state, rig in itertools.product(states, (RIGS["surround"], RIGS["windscreen"])):
        pictures = jax.device_get(pictures_of(rig, state, heights))
        reference = Reference(env, state)
        for agent in range(env.config.num_agents):
            if state.present is not None and not state.present[agent]:
                continue  # it stands far away
            seen = pictures.seen[agent]
            depth, truth = reference.look(rig, agent)
            off = pictures.depth[agent] - np.minimum(depth, rig.reach)
            found = [np.abs(off) < CLOSE, seen == truth]
            found += [seen == reference.look(rig, agent, True)[1]] * meshes
            shares.append(seen.size * np.mean(found, axis=(1, 2, 3)))
            pixels += seen.size
    return Agreement(pixels, *(np.sum(shares, axis=0) / pixels).tolist())


@dataclasses.dataclass(frozen=True)
class CamerasConfig(CheckedConfig):
    """Settings of `python eval/cameras.py`.

    Attributes:
        layouts: of the lots; by default one of every family.
        lots: of each layout.
    """

    layouts: tuple[str, ...] = ()
    lots: Count = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.layouts:
            layout_config(name)  # raises what is unknown


def run(config: CamerasConfig) -> int:
    """Prints the table; returns 1 where too few pixels agree."""
    rows, missed = [], 0
    for name in config.layouts or families():
        env = environment(name)
        reset = jax.jit(lambda key: env.reset(key)[0])  # noqa: B023
        states = [reset(jax.random.key(seed)) for seed in range(config.lots)]
        found = compare(env, states)
        shares = (f"{share:.2%}" for share in found[1:])
        names = "depth within 1 cm", "classes", "meshes"
        row = {"layout": f"`{name}`", "pixels": f"{found.pixels:,}"}
        rows.append(row | dict(zip(names, shares, strict=True)))
        missed += min(found.depth, found.classes) < ENOUGH
    print(markdown(rows))
    return int(missed > 0)


main = command(CamerasConfig, run, __doc__)

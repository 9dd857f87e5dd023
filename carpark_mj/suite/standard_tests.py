"""Tests that standards name, as levels of the suite: `iso16787`, `ncap_rear`, `r158`.

`LEVEL:CAR` is the level of another car than `compact`, a preset or data sheet. Numbers
are of public text; none of the standards was at hand. What is marked [own] is not.

- `iso16787`, ISO 16787:2017, assisted parking between two cars like one's own (type I),
  on the right and on the left. Slots [1, 2]: parallel, longer than the car by a quarter
  of its length, of 4 m at least and 6 m at most, and 0.2 m deeper than its width, with
  a kerb or without; perpendicular, 1.2 m wider than the car, as deep as it is long. The
  end, within 3 degrees and 0.15 m, is that of GB/T 41630-2022 for parallel slots
  without a kerb [3], here for all and also along the slot. The start beyond the slot is
  [own]. Not found: slots between markings (type II), ISO's own end positions.
- `ncap_rear`, Euro NCAP AEB/LSS VRU 4.5.1, Car-to-Pedestrian Reverse: speeds, shares of
  the width, persons, and the crossing of 4 m at 5 km/h, 1.5 m to speed up [4]. The car
  begins 10 m before the person [4, not of the protocol], at most as fast as it
  reverses. NCAP's driver keeps the speed until the brake acts; here the policy drives
  to a bay behind the person [own]. Dummies are discs, as wide as their sides' mean.
- `r158`, UN R158: something 0.3 m wide stands 0.2 to 1 m behind the car, as wide as
  that [5, 6]; it is 0.8 m high, which movers are not. R158 asks that it is shown or
  detected; here a car that stands must get to a bay behind it without a touch [own].

ISO 20900:2023 and ISO 23374-1:2023 have no level: their scope and contents are public,
numbers of their tests are not.

[1] blog.csdn.net/weixin_50875614/article/details/128810413
[2] blog.csdn.net/qq_42957717/article/details/128096315
[3] blog.csdn.net/qq_42957717/article/details/134181325
[4] github.com/vectorgrp/OSC-NCAP-scenarios, AEB_VRU_2023, CPRA_Cs and CPRA_Cm
[5] efs.consulting/news/pc197_three-new-un-vehicle-regulations
[6] zj-attc.com/en/4/13913/911705
"""

import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.registry import FixedLayoutConfig
from carpark_mj.layouts.types import BayEnd, Layout, WallKind
from carpark_mj.suite.actors import Actor, Spread
from carpark_mj.suite.levels import LEVELS, CaseLevel, Cases
from carpark_mj.suite.scenario import Scenario, Tolerance
from carpark_mj.suite.tpcap import stack_layouts
from carpark_mj.vehicle import VehicleParameters, preset

Tests = list[tuple[str, Scenario]]  # with the kinds of their cases
REPEATED = 20  # repetitions of an ISO 16787 slot [own]
STARTS = Spread(place=0.2, heading=0.05)  # m, rad, of these [own]
BESIDE = 1.0  # m between the car and those it parks between [own]
KMH = 1 / 3.6  # m/s
BEFORE = 10.0  # m from the bumper to the person
PERSONS = {"adult": (0.6 + 0.5) / 2, "child": (0.711 + 0.298) / 2}  # m
STANDING = (  # km/h, share of the width, person
    *((4, 0.5, "adult"), (8, 0.5, "child"), (4, 0.25, "child")),
    *((8, 0.25, "adult"), (4, 0.75, "child"), (8, 0.75, "adult")),
)
CROSSING = ((4, "adult"), (8, "child"))
PACE, SIDE, RUN_UP = 5 * KMH, 4.0, 1.5  # m/s and m of crossing persons
WIDE, BEHIND = 0.3, (0.2, 0.6, 1.0)  # m, of objects of R158; the middle one is [own]


@dataclasses.dataclass(frozen=True)
class Ground(FixedLayoutConfig):
    """Open ground with bays, and maybe a kerb, of poses and sizes."""

    bay: tuple[tuple[float, ...], ...] = ()  # x, y, heading, length, width
    kerb: tuple[float, ...] | None = None  # the same
    end: BayEnd = BayEnd.EITHER
    family: str = "ground"

    @property
    def layout(self) -> Layout:
        """The lot, 40 m x 30 m."""
        return _drawn(self)


@functools.cache
def _drawn(ground: Ground) -> Layout:
    rows, half = np.array(ground.bay), (20.0, 15.0)
    edge = np.array([ground.kerb or (0.0, -half[1], 0.0, 2 * half[0], 0.2)])
    with jax.ensure_compile_time_eval():  # also while a program is traced
        start = spawns(np.zeros((1, 3)), np.ones((1, 2)), 0.1)
        kerb = walls(edge[:, :3], edge[:, 3:], WallKind.KERB)
        spots = bays(rows[:, :3], rows[:, 3:], end=ground.end)
        return jax.device_get(assemble(np.array(half), spots, kerb, start))


def iso16787(vehicle: str, car: VehicleParameters) -> Tests:
    """Slots on the right and left of a car that has passed them."""
    long = car.length + 0.25 * min(max(car.length, 4.0), 6.0)
    deep, wide = car.width + 0.2, car.width + 1.2
    kerb = (0.0, -deep - 0.1, 0.0, 30.0, 0.2)
    limits = Tolerance(distance=0.15, heading=math.radians(3.0))
    found: Tests = []
    for kind, size, yaw, edge in (
        ("parallel", (long, deep), 0.0, None),
        ("parallel_kerb", (long, deep), 0.0, kerb),
        ("perpendicular", (car.length, wide), math.pi / 2, None),
    ):
        along, across = size if yaw == 0.0 else size[::-1]
        # Neighbours have bays of their size; fronts are on y = 0.
        own = car.length, car.width
        x, y = (along + own[yaw > 0.0]) / 2, -own[yaw == 0.0] / 2
        row = ((-x, y, yaw, *own), (0.0, -across / 2, yaw, *size), (x, y, yaw, *own))
        lot = Ground(bay=row, kerb=edge)
        for side, way in (("right", 1.0), ("left", -1.0)):
            place = way * (along + car.length) / 2, BESIDE + car.width / 2
            start = (*place, 0.0 if way > 0.0 else math.pi)
            same: Any = {"parked": (0, 2), "rule": limits, "repetitions": REPEATED}
            made = Scenario(lot, start, 1, vehicle, spread=STARTS, **same)
            found.append((f"{kind}_{side}", made))
    return found


def _behind(
    vehicle: str, car: VehicleParameters, speed: float, before: float, person: Actor
) -> Scenario:
    """A car that reverses to a bay beyond a person at x = 0, from so far before it."""
    bay = (-car.length / 2 - 2.0, 0.0, 0.0, car.length + 0.5, car.width + 0.7)
    lot = Ground(bay=(bay,), end=BayEnd.TAIL_FIRST)
    start = (before + car.length / 2, 0.0, 0.0)
    speed = -min(speed, car.max_reverse_speed)
    return Scenario(lot, start, 0, vehicle, speed=speed, movers=(person,))


def ncap_rear(vehicle: str, car: VehicleParameters) -> Tests:
    """Persons that stand behind a reversing car or cross behind it."""
    found: Tests = []

    def add(kind: str, pace: float, who: str, y: float, **trigger: Any) -> None:
        # It speeds up evenly, here at half its speed.
        path = ((0.0, y - RUN_UP, PACE / 2), (0.0, y - 4 * SIDE, PACE))
        same: Any = {"path": path, "size": (PERSONS[who],) * 2, "yields": False}
        person = Actor(start=(0.0, y), **same, **trigger)
        found.append((kind, _behind(vehicle, car, pace * KMH, BEFORE, person)))

    for pace, share, who in STANDING:
        side = -car.width * (share - 0.5)
        add(f"stationary_{100 * share:.0f}", pace, who, side, after=1e6)
    for pace, who in CROSSING:
        # Both reach the same place if the car keeps its speed.
        time = RUN_UP / (PACE / 2) + (SIDE - RUN_UP) / PACE
        away = min(pace * KMH, car.max_reverse_speed) * time + car.length / 2
        add("moving_50", pace, who, SIDE, near=math.hypot(away, SIDE))
    return found


def r158(vehicle: str, car: VehicleParameters) -> Tests:
    """Objects behind a car that stands."""
    found: Tests = []
    for gap in BEHIND:
        for share in (-0.5, 0.0, 0.5):
            thing = Actor(start=(0.0, share * car.width), size=(WIDE, WIDE))
            made = _behind(vehicle, car, 0.0, gap + WIDE / 2, thing)
            found.append((f"{gap:g} m", made))
    return found


@functools.cache
def standard_level(name: str, vehicle: str) -> CaseLevel:
    """The level of a test; its scenarios take turns."""
    vehicle = vehicle or "compact"
    kinds, scenarios = zip(*TESTS[name](vehicle, preset(vehicle)), strict=True)
    first, level = scenarios[0], f"{name}:{vehicle}" if vehicle != "compact" else name
    repeats = first.repetitions
    turns = np.arange(len(kinds) * repeats).reshape(len(kinds), -1).T.ravel()

    def pick(which: slice) -> Cases:
        starts = [one.pick(slice(None)).start for one in scenarios]
        whole = jax.tree.map(lambda *parts: jnp.concatenate(parts), *starts)
        rows = turns[which]
        start = jax.tree.map(lambda leaf: leaf[rows], whole)
        lots = stack_layouts([one.layout for one in scenarios])
        layouts = jax.tree.map(lambda leaf: leaf[rows // repeats], lots)
        number = np.arange(len(turns))[which]
        return Cases(level, number, np.array(kinds)[rows // repeats], layouts, start)

    data = hashlib.sha256(repr(scenarios).encode()).hexdigest()
    source, rules = f"Standard test {name}", (first.rule_name, vehicle)
    return CaseLevel(range(len(turns)), data, pick, first.env, source, *rules)


TESTS: dict[str, Callable[[str, VehicleParameters], Tests]] = {
    "iso16787": iso16787,
    "ncap_rear": ncap_rear,
    "r158": r158,
}
for _name in TESTS:
    LEVELS.register(_name, functools.partial(standard_level, _name))

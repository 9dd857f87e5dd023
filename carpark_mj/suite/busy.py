"""The level `busy`: people, a cart or another car get in the way.

The 1,000 held-out cases are of five groups in turn, in an aisle between two rows of
perpendicular bays. The package stores them in whole millimetres, 1e-4 rad, mm/s and ms.

- `crossing`: a person at 0.9 to 1.7 m/s from one row into the other, in the way of a
  car at 2 m/s as it comes, or up to 2.5 m before.
- `dart_out`: a child at 2 to 3 m/s from a gap between parked cars, up to 2 m before.
- `backing_out`: a car that reverses out of its bay by 2.5 m or more when a car is 6 to
  11 m away, stands 1 to 4 s and drives back in.
- `cart`: a cart that rolls askew into the aisle at 0.8 to 1.8 m/s, slows down by 0.1 to
  0.3 m/s² and stays.
- `crowded_aisle`: twelve pedestrians, none within 4 m at first.

Persons, carts and cars follow a script, `carpark_mj.movers.scripted`.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, LayoutConfig, MetricsConfig
from carpark_mj.geometry import norm
from carpark_mj.layouts import build
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import Layout, WallKind
from carpark_mj.movers.pedestrians import Pedestrians
from carpark_mj.movers.scripted import ScriptedBox, ScriptedPerson
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite.levels import LEVELS, CaseLevel, Cases, CaseStart, read_published

COLUMNS = 10  # bays in a row
WIDTH, LENGTH = 2.5, 5.0  # m, of a bay
END = 4.5  # m of aisle beyond the rows
HALF_X = COLUMNS * WIDTH / 2 + END  # m
WALL = 0.25  # m, thickness


def bay_x(column: Any) -> Any:
    """X of the middles of bays [m]."""
    return (column - (COLUMNS - 1) / 2) * WIDTH


def aisle_lot(aisle: jax.Array, absent: jax.Array) -> Layout:
    """A lot with an aisle of a width [m], without the bay `absent` (-1 = with all).

    Bays 0 to 9 are the lower row, 10 to 19 the upper one, from the left.
    """
    middle = aisle / 2 + LENGTH / 2
    x = bay_x(jnp.arange(COLUMNS))
    low = jnp.stack(jnp.broadcast_arrays(x, -middle, jnp.pi / 2), axis=-1)
    high = jnp.stack(jnp.broadcast_arrays(x, middle, -jnp.pi / 2), axis=-1)
    there = jnp.arange(2 * COLUMNS) != absent
    half_y = aisle / 2 + LENGTH
    ground = jnp.stack([jnp.float32(2 * HALF_X), aisle])
    lane = build.two_lanes(jnp.zeros(3), ground)
    return build.assemble(
        jnp.stack([jnp.float32(HALF_X), half_y]),
        build.bays(jnp.concatenate([low, high]), (LENGTH, WIDTH), mask=there),
        build.boundary(HALF_X, half_y, WALL, WallKind.WALL),
        build.lanes(*lane, one_way=False),
        build.spawns_in(DesignCar(), jnp.zeros((1, 3)), ground[None]),
    )


@dataclasses.dataclass(frozen=True)
class BusyAisle(LayoutConfig):
    """An aisle between two rows of ten bays.

    Attributes:
        aisle: range of its width [m].
    """

    aisle: tuple[float, float] = (6.0, 7.0)
    family: str = "busy_aisle"

    @property
    def min_bays(self) -> int:
        """The fewest bays: one may be absent."""
        return 2 * COLUMNS - 1

    def generate(self, key: jax.Array) -> Layout:
        """Draws the width."""
        low, high = self.aisle
        width = jax.random.uniform(key, minval=low, maxval=high)
        return aisle_lot(width, jnp.int32(-1))


VERSION = 1
FILE = Path(__file__).with_name(f"busy_{VERSION}.npz")
SHA256 = "6004375ac7decf7dd5d427f72a45b2f20f606a670a4d605a124abec02d2c4c63"
CASES = 1000
GROUPS = ("crossing", "dart_out", "backing_out", "cart", "crowded_aisle")
STEP = 1e-3  # m, m/s, m/s² or s of the whole numbers in the file
RADIAN = 1e-4
CART = (1.0, 0.6)  # m


@functools.cache
def load_held_out() -> dict[str, np.ndarray]:
    """The columns of the cases, (1000, ...) whole numbers.

    In steps of `unit`: `aisle`, its width; the car's `pose` and the bay `goal`;
    `absent`, a bay that the lot lacks; and of `Script` what gets in the way.
    """
    return read_published(FILE, SHA256)


def unit(name: str, width: int) -> np.ndarray:
    """(width,) steps of a column's whole numbers."""
    if name in ("goal", "absent", "returns"):
        return np.ones(1)
    steps = np.full(width, STEP)
    if name == "direction" or width == 3:
        steps[-1] = RADIAN
    return steps


NAME = "busy"
PARKED = 14  # cars
CLEAR = 4.0  # m about the middle of the car that nobody stands in at first
CROWD = Pedestrians(number=12)
PERSON, BOX = ScriptedPerson(), ScriptedBox()
BY_PERSON, BY_BOX = ("crossing", "dart_out"), ("backing_out", "cart")
EXTRA = ("near_misses", "min_person_gap", "person_speed", "hard_braking", "waiting")


def busy_env(env: EnvConfig) -> EnvConfig:
    """An environment of the suite with the busy aisle and its moving obstacles."""
    return dataclasses.replace(
        env,
        layout=BusyAisle(),
        num_parked_cars=PARKED,
        movers=(PERSON, BOX, CROWD),
        metrics=MetricsConfig(safety=True, extra=EXTRA),
    )


def pick(which: slice) -> Cases:
    """Cases that follow each other."""
    number = np.arange(CASES)[which]
    columns = {name: x[which] for name, x in load_held_out().items()}
    group = number % len(GROUPS)
    layouts, start = _begin(columns, number, group)
    return Cases(NAME, number, np.array(GROUPS)[group], layouts, start)


@jax.jit
@jax.vmap
def _begin(columns: Any, number: jax.Array, group: jax.Array) -> Any:
    """The layout and the start of a case."""
    case = {
        n: x * jnp.asarray(unit(n, len(x)), jnp.float32) for n, x in columns.items()
    }
    case = {name: x[0] if len(x) == 1 else x for name, x in case.items()}
    key = jax.random.key(number)
    layout = aisle_lot(case["aisle"], columns["absent"][0])
    present = [
        jnp.isin(group, jnp.array([GROUPS.index(x) for x in names]))
        for names in (BY_PERSON, BY_BOX, ("crowded_aisle",))
    ]
    names = ("direction", "distance", "speed", "slowing", "pause", "trigger")
    script = dataclasses.replace(
        PERSON.init(key, layout),
        **{name: case[name] for name in ("start", *names, "size")},
        returns=case["returns"] > 0,
        present=present[0],
    )
    crowd = CROWD.init(jax.random.fold_in(key, 1), layout)
    away = norm(crowd.xy - case["pose"][:2]) > CLEAR
    movers = (
        script,
        dataclasses.replace(script, present=present[1]),
        dataclasses.replace(crowd, present=crowd.present & away & present[2]),
    )
    options = ResetOptions(pose=case["pose"][None], goal=columns["goal"])
    return layout, CaseStart(key, options, movers)


LEVELS.register(NAME, CaseLevel(range(CASES), SHA256, pick, busy_env))

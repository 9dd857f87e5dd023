"""The levels of the suite and their cases, equal for all users.

HOPE's levels have 1,000 held-out cases each. The package stores them, drawn once by
`HopeConfig` from lots of the test split (`carpark_mj.layouts.registry`), in whole
millimetres and 1e-4 rad. Cases of `normal` and `complex` are perpendicular and parallel
in turn, those of `extreme` are parallel.

A package may register a `CaseLevel` of its own. The level may change the suite's
environment, and say how its cases begin: with movers, given starts and goals.

Another car may drive through the aisle of HOPE's cases. HOPE's program has none, so the
numbers are ours. It keeps to the far side of the aisle and drives straight through at
1 m/s. It stops for a car ahead. If that car stays, it backs off to its start and tries
again: in aisles of 3.5 to 4.5 m two cars cannot pass each other, so a car that never
stopped, or stopped for ever, would make some cases unsolvable. It is an ordinary agent:
its start and its goal, the two ends of the aisle, are a spawn region and a bay.
"""

import dataclasses
import functools
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig
from carpark_mj.extensions import Registry
from carpark_mj.geometry import (
    box_corners,
    boxes_overlap,
    move_forward,
    to_local,
    to_world,
)
from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.standards import Level
from carpark_mj.layouts.types import (
    BayKind,
    Layout,
    WallKind,
    layout_maxima,
    pad_layout,
)
from carpark_mj.observations import observe
from carpark_mj.precision import full_float32
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite import tpcap
from carpark_mj.suite.hope import MARGIN, HopeConfig
from carpark_mj.suite.tpcap import TPCAP_CAR
from carpark_mj.types import State
from carpark_mj.vehicle.drive import HOLD_SPEED

if TYPE_CHECKING:
    from carpark_mj.env import ParkingEnv


class CaseStart(NamedTuple):
    """How n cases begin."""

    key: jax.Array  # (n,) keys, each of a case: of what moves and where others park
    options: ResetOptions  # (n, ...) starts and goals
    movers: tuple[Any, ...]  # (n, ...) states of the environment's movers
    # (n, cars) int32 bays of the parked cars; None = drawn
    parked: jax.Array | None = None


class Cases(NamedTuple):
    """Some cases of a level."""

    level: str  # its name
    number: np.ndarray  # (n,) which of the level's
    # (n,) str, `parallel`, `perpendicular`, `published` of TPCAP's, `recorded` of
    # ParkBench's, `repeated` of scenarios, `drawn` of whole lots, the car of `sheets`
    kind: np.ndarray
    layouts: Layout  # (n, ...) of the same shapes in all of HOPE's levels
    # how they begin; None = at the spawn region's middle
    start: CaseStart | None = None


@dataclasses.dataclass(frozen=True)
class CaseLevel:
    """A level: a fixed list of cases."""

    numbers: range  # of its cases
    sha256: str  # of the data of its cases
    pick: Callable[[slice], Cases]  # its cases whose places in `numbers` are in a slice
    # its environment, from that of the suite
    env: Callable[[EnvConfig], EnvConfig] = lambda env: env
    source: str = ""  # of its cases, for tables; empty = `Cases of` the level
    rule: str = ""  # parked rule of its environment; empty = the suite's
    vehicle: str = ""  # of its environment; empty = the suite's

    @property
    def fingerprint(self) -> str:
        """The first digits of `sha256`."""
        return self.sha256[:16]


# Levels of other packages, `busy`, and those of whole lots (`carpark_mj.suite.lots`).
EXTRA_LEVELS: Registry[CaseLevel] = Registry("level of the suite")
# Levels of a user's files, `NAME:PATH`: readers of the path by name.
FILE_LEVELS: dict[str, Callable[[str], CaseLevel]] = {}
# Levels of a car, `NAME` or `NAME:CAR`: makers from the car, "" = the usual one.
CAR_LEVELS: dict[str, Callable[[str], CaseLevel]] = {}
VERSION = 1
FILE = Path(__file__).with_name(f"held_out_{VERSION}.npz")
SHA256 = "773f2791aba75242a8e3f765aaa6d1263017e218add2a1b30b8cffaf74989b91"
CASES = 1000  # a level
HOPE_LEVELS: tuple[Level, ...] = get_args(Level)  # driven by default
TPCAP_LEVEL = "tpcap"
METRE, RADIAN = 1e-3, 1e-4  # steps of the numbers in the file
POSE = np.array([METRE, METRE, RADIAN])


def read_published(file: Path, sha256: str) -> dict[str, np.ndarray]:
    """The arrays of an archive in the package; ValueError if it was changed."""
    data = file.read_bytes()
    tpcap.require_published(file, data, sha256)
    with np.load(io.BytesIO(data)) as archive:
        return {name: archive[name] for name in archive.files}


@functools.cache
def load_held_out(level: Level) -> tuple[Layout, np.ndarray]:
    """Held-out cases (1000, ...), padded alike, and which are parallel, for `tpcap`."""
    arrays = read_published(FILE, SHA256)
    part = {name: arrays[f"{level}_{name}"] for name in STORED}
    return jax.vmap(_layout)(part), part["parallel"]


STORED = ("goal", "bay", "start", "wall", "size", "extent", "parallel")


def _layout(case: Any) -> Layout:
    mask = case["size"].any(axis=-1)
    return assemble(
        case["extent"] * METRE,
        bays((case["goal"] * POSE)[None], case["bay"] * METRE),
        walls(case["wall"] * POSE, case["size"] * METRE, WallKind.ISLAND, mask),
        spawns((case["start"] * POSE)[None], (METRE, METRE), 0.0),
    )


def _pick_hope(level: Level, which: slice) -> Cases:
    layouts, parallel = load_held_out(level)
    maxima = layout_maxima([load_held_out(name)[0] for name in HOPE_LEVELS])
    pad = jax.vmap(lambda layout: pad_layout(layout, maxima))
    padded = pad(jax.tree.map(lambda x: x[which], layouts))
    kind = np.where(parallel[which], "parallel", "perpendicular")
    return Cases(level, np.arange(CASES)[which], kind, padded)


def _pick_tpcap(which: slice) -> Cases:
    number = np.array(tpcap.NUMBERS[which])
    layouts = jax.tree.map(lambda x: x[which], tpcap.load_tpcap())
    return Cases(TPCAP_LEVEL, number, np.full(len(number), "published"), layouts)


_HELD_OUT = f"Held-out cases version {VERSION}"
LEVELS = {
    level: CaseLevel(
        range(CASES), SHA256, functools.partial(_pick_hope, level), source=_HELD_OUT
    )
    for level in HOPE_LEVELS
}
LEVELS[TPCAP_LEVEL] = CaseLevel(
    tpcap.NUMBERS, tpcap.SHA256, _pick_tpcap, source="TPCAP's cases"
)


def find_level(level: str) -> CaseLevel:
    """A level by name; `ValueError` if there is none, or its files are faulty."""
    name, colon, rest = level.partition(":")
    if name in CAR_LEVELS:
        return CAR_LEVELS[name](rest)
    if colon and name in FILE_LEVELS:
        return FILE_LEVELS[name](rest)
    if level in LEVELS:
        return LEVELS[level]
    if level in EXTRA_LEVELS:
        return EXTRA_LEVELS[level]
    files = (f"{name}:PATH" for name in FILE_LEVELS)
    known = ", ".join((*LEVELS, *EXTRA_LEVELS, *CAR_LEVELS, *files))
    raise ValueError(f"level must be one of {known}, not {level!r}")


def require_filmed(level: str) -> None:
    """Refuses films from files, which lack what moves and parks in some levels."""
    if find_level(level).pick(slice(0, 1)).start is not None:
        raise ValueError(
            f"files lack the movers and parked cars of level {level}: make its videos "
            "with the command that drives it, without --combine"
        )


def in_order(levels: Iterable[str]) -> list[str]:
    """Levels as tables list them: those of this module, then others by name."""
    found = set(levels)
    return [x for x in LEVELS if x in found] + sorted(found - {*LEVELS})


def pick_cases(
    level: str, count: int, first: int = 0, with_moving_car: bool = False
) -> Cases:
    """So many cases of a level from the `first` on; only HOPE's have a moving car."""
    cases = find_level(level).pick(slice(first, first + count))
    return add_ends(cases) if with_moving_car and level in HOPE_LEVELS else cases


CAR = 1  # its number among the agents, its bay's and its start's
SPEED = 1.0  # m/s
ACCELERATION = 1.0  # m/s², to either side: `tpcap` cannot speed up faster
GAP = 0.3  # m to the far edge of the aisle, and kept free on both sides of its way
LOOK_AHEAD = 1.0  # m of its way that must be free: a step, the braking way and `GAP`
PATIENCE = 5.0  # s that it waits; the planner's cars replan after 4 s
STOPPING = 0.5  # m before the goal: from there it brakes


class Progress(NamedTuple):
    """State of the moving car's driver, carried between steps; float32."""

    direction: jax.Array  # 1 towards the goal or -1 while it backs off
    waited: jax.Array  # how long it has waited [s]


def add_ends(cases: Cases) -> Cases:
    """HOPE's cases with the start and the goal of a moving car.

    It comes from the left in two cases, from the right in the next two, so that
    both happen with either kind of bay.
    """
    layouts = cases.layouts
    way = np.where(cases.number // 2 % 2 == 0, 1.0, -1.0)
    end = layouts.extent[:, 0] - MARGIN - TPCAP_CAR.length / 2
    y, yaw = _line(cases), np.where(way > 0, 0.0, np.pi)
    goal = jnp.stack([way * end, y, yaw], axis=-1)
    start = jnp.stack([-way * end, y, yaw], axis=-1)
    size = jnp.array(TPCAP_CAR.size) + 2 * MARGIN
    rows = layout_maxima([layouts])
    rows = dataclasses.replace(rows, bays=CAR + 1, spawns=CAR + 1)
    padded = jax.vmap(lambda layout: pad_layout(layout, rows))(layouts)
    layouts = dataclasses.replace(
        padded,
        bay_pose=padded.bay_pose.at[:, CAR].set(goal),
        bay_size=padded.bay_size.at[:, CAR].set(size),
        # Nobody else's goal.
        bay_kind=padded.bay_kind.at[:, CAR].set(BayKind.RESERVED),
        bay_mask=padded.bay_mask.at[:, CAR].set(True),
        spawn_pose=padded.spawn_pose.at[:, CAR].set(start),  # no area: never drawn
        spawn_mask=padded.spawn_mask.at[:, CAR].set(True),
    )
    return cases._replace(layouts=layouts)


def _line(cases: Cases) -> jax.Array:
    """(n,) y of the car's way [m]."""
    layouts, level = cases.layouts, cast(Level, cases.level)
    aisle = [HopeConfig(level, kind).room.aisle for kind in cases.kind.tolist()]
    start = layouts.spawn_pose[:, 0]
    axle = move_forward(start, -TPCAP_CAR.centre_offset)[:, 1]  # is in the aisle
    corners = box_corners(layouts.wall_pose, layouts.wall_size)[..., 1]
    near = layouts.wall_mask & (corners < axle[:, None, None]).all(axis=-1)
    edge = jnp.where(near, corners.max(axis=-1), -jnp.inf).max(axis=-1) + MARGIN
    return edge + jnp.array(aisle) - GAP - TPCAP_CAR.width / 2


def reset_with_moving_car(
    env: "ParkingEnv", layout: Layout, key: jax.Array
) -> tuple[State, jax.Array]:
    """Starts a lot of `add_ends`: the first agent as if alone, then the moving car."""
    state, _ = env.reset_to_layout(layout, key, jnp.int32(1))
    own = jnp.arange(env.num_agents) == CAR
    pose_w = jnp.where(own[:, None], layout.spawn_pose[CAR], state.motion.pose_w)
    physics = env.physics.place(state.physics, own, pose_w, state.physics.vehicle)
    state = dataclasses.replace(
        state,
        physics=physics,
        motion=env.physics.read(physics),
        goal=jnp.where(own, CAR, state.goal),
        active=state.active | own,
        present=jnp.ones_like(own),
    )
    return state, observe(env.config, state)


@full_float32
def drive_moving_car(
    state: State, progress: Progress, ctrl_dt: float
) -> tuple[jax.Array, Progress]:
    """Its action (2,) for a control step of `ctrl_dt` [s], and the progress then."""
    motion = state.motion
    pose, speed = motion.pose_w[CAR], motion.speed[CAR]
    goal = state.layout.bay_pose[CAR]
    remaining = -to_local(goal, pose)[0]
    whole = -to_local(goal, state.layout.spawn_pose[CAR])[0]
    # Back at its start it tries again.
    direction = jnp.where(remaining >= whole - STOPPING, 1.0, progress.direction)
    # Whether another car is on the next `LOOK_AHEAD` of its way.
    length, width = motion.size[CAR]
    ahead = jnp.zeros(3).at[0].set(direction * (length + LOOK_AHEAD) / 2)
    size = jnp.stack([jnp.full_like(width, LOOK_AHEAD), width + 2 * GAP])
    meets = boxes_overlap(to_world(pose, ahead), size, motion.pose_w, motion.size)
    blocked = jnp.any(meets.at[CAR].set(False))
    waited = jnp.where(blocked, progress.waited + ctrl_dt, 0.0)
    gives_up = waited > PATIENCE
    after = Progress(
        direction=jnp.where(gives_up, -direction, direction),
        waited=jnp.where(gives_up, 0.0, waited),
    )
    stops = blocked | (remaining < STOPPING)
    target = jnp.where(stops, 0.0, direction * SPEED)
    pedal = _pedal(state, target, ctrl_dt)
    held = stops & (jnp.abs(speed) < HOLD_SPEED)  # a pedal would drive it on
    pedal = jnp.where(held, 0.0, pedal)
    return jnp.stack([jnp.zeros_like(pedal), pedal]), after


def _pedal(state: State, target: jax.Array, ctrl_dt: float) -> jax.Array:
    """() pedal that reaches a speed [m/s] in a control step, or comes nearest to it."""
    speed, vehicle = state.motion.speed[CAR], state.physics.vehicle
    change = jnp.clip((target - speed) / ctrl_dt, -ACCELERATION, ACCELERATION)
    brakes = change * speed < 0.0
    limit = jnp.where(brakes, vehicle.max_deceleration, vehicle.max_acceleration)
    return jnp.clip(change / limit[CAR], -1.0, 1.0)

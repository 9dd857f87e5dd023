"""Two rows of slots along a corridor: vertical, diagonal or parallel (Pandita 2022).

Numbers follow the thesis's program, a fork of highway-env. Its x axis points to
the right and its y axis down on the screen, ours up: its pictures are mirrored,
positions and headings are equal.

Slots 0 to n - 1 lie at y > 0, from left to right, slots n to 2 n - 1 at y < 0. A slot's
centre line leads away from the corridor, in parallel slots along the row. The goal is
its middle, head-in: the bay's heading (`Layout.bay_pose`) is against the line. Parked
cars stand half a slot length along it, in diagonal slots in front of the middle, for
their centre lines are longer. There are no walls at the sides. A lot has one goal; its
other slots are `BayKind.RESERVED`.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.config.checks import Count, Finite, Positive
from carpark_mj.layouts.build import assemble, bays, spawns, walls
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import BayKind, Layout, WallKind

GAP = 1.0  # m between parallel slots
OBSTACLE = 2.0  # m, side of an obstacle
MORE_OBSTACLES = 6  # in a row than slots
START = 1e-3  # m, side of the spawn region
MARGIN = 2.0  # m of ground around everything
# highway-env's car, the longest that is to start in the corridor.
CAR = DesignCar(length=5.0, width=2.0)


@dataclasses.dataclass(frozen=True)
class SlotsConfig(LayoutConfig):
    """Table A1.1 of the thesis; lengths [m].

    The other vehicles are `EnvConfig.num_parked_cars`.

    Attributes:
        slots_per_row: n, slots on each side.
        goal_slot: number of the goal's slot; None = drawn with the lot.
        diagonal_shift: by how much slots lean, along the row; 0 = vertical.
        parallel: slots lie along the corridor instead.
        half_corridor: from the corridor's middle to the slots ("corridor width" of the
            table); to the middle of parallel ones.
        slot_width: along the row; of parallel slots across it.
        slot_length: from the corridor to the slots' far ends; along parallel slots.
        obstacles: whether rows of solid squares stand behind the slots.
        start: centre (x, y) of the agent's car.
        start_heading: of it [rad]; None = any.
        family: fixed.
    """

    slots_per_row: Count = 6
    goal_slot: int | None = 2
    diagonal_shift: Finite = 0.0
    parallel: bool = False
    half_corridor: Positive = 10.0
    slot_width: Positive = 4.0
    slot_length: Positive = 8.0
    obstacles: bool = True
    start: tuple[float, float] = (10.0, 0.0)
    start_heading: Finite | None = math.pi
    family: str = "slots"
    is_enclosed = False  # cars can leave

    def __post_init__(self) -> None:
        super().__post_init__()
        last = 2 * self.slots_per_row - 1
        if self.goal_slot is not None and not 0 <= self.goal_slot <= last:
            raise ValueError(
                f"goal_slot must be a whole number from 0 to {last}, or random (None), "
                f"not {self.goal_slot!r}"
            )
        if not all(map(math.isfinite, self.start)):
            raise ValueError(f"start must be finite, not {self.start}")
        if self.parallel and self.diagonal_shift:
            raise ValueError(
                f"diagonal_shift must be 0 in parallel slots, not {self.diagonal_shift}"
            )
        length, width = self.bay_size
        if length < CAR.length or width < CAR.width:
            raise ValueError(
                f"slots of slot_length {self.slot_length} m, slot_width "
                f"{self.slot_width} m and diagonal_shift {self.diagonal_shift} m have "
                f"{max(length, 0.0):.2f} m x {width:.2f} m between their lines, the "
                f"car needs {CAR.length} m x {CAR.width} m"
            )
        least = abs(self.start[1]) + self._start_reach + self._slot_depth
        if self.half_corridor < least:
            raise ValueError(
                f"half_corridor must be at least {least:.2f} m, so that a car of "
                f"{CAR.length} m x {CAR.width} m can stand at start {self.start}, not "
                f"{self.half_corridor}"
            )

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return 2 * self.slots_per_row

    @property
    def min_goals(self) -> int:
        """One: the agent starts at one place."""
        return 1

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
        return self.goal_slot is None

    @property
    def bay_size(self) -> tuple[float, float]:
        """Length and width of the largest rectangle between a slot's lines [m]."""
        if self.parallel:
            return self.slot_length, self.slot_width
        axis = math.hypot(self.slot_length, self.diagonal_shift)
        sin, cos = self.slot_length / axis, abs(self.diagonal_shift) / axis
        return axis - self.slot_width * cos, self.slot_width * sin

    @property
    def _slot_depth(self) -> float:
        """How far parallel slots reach into the corridor [m]."""
        return self.slot_width / 2 if self.parallel else 0.0

    @property
    def _start_reach(self) -> float:
        """Half the extent of the car at the start across the corridor [m]."""
        if self.start_heading is None:
            return math.hypot(*CAR.size) / 2
        across = abs(math.sin(self.start_heading)), abs(math.cos(self.start_heading))
        return (CAR.length * across[0] + CAR.width * across[1]) / 2

    def generate(self, key: jax.Array) -> Layout:
        """Builds the lot; only a random goal depends on the key."""
        begin, end = centre_lines(self)
        along = end - begin
        axis = np.hypot(*along.T)[:, None]
        yaw = np.arctan2(-along[:, 1], -along[:, 0])[:, None]
        middle = np.concatenate([(begin + end) / 2, yaw], axis=1)
        taken = begin + along / axis * self.slot_length / 2
        taken = np.concatenate([taken, yaw], axis=1)

        goal = self.goal_slot
        if goal is None:
            goal = jax.random.randint(key, (), 0, len(begin))
        is_goal = jnp.arange(len(begin)) == goal
        obstacles = _obstacles(self)
        obstacle_pose = np.pad(obstacles, ((0, 0), (0, 1)))
        heading = self.start_heading
        start = np.array([[*self.start, heading or 0.0]])
        return assemble(
            _extent(self, np.concatenate([middle, taken]), obstacle_pose, start),
            bays(
                jnp.where(is_goal[:, None], middle, taken),
                self.bay_size,
                jnp.where(is_goal, BayKind.STANDARD, BayKind.RESERVED),
            ),
            walls(obstacle_pose, (OBSTACLE, OBSTACLE), WallKind.ISLAND),
            spawns(start, (START, START), math.pi if heading is None else 0.0),
        )


# The five scenarios that the thesis pictures; `slots` is the fourth.
SINGLE = SlotsConfig(slots_per_row=1, goal_slot=0)
register_layout("slots_single", SINGLE)
register_layout(
    "slots_single_diagonal", dataclasses.replace(SINGLE, diagonal_shift=6.0)
)
register_layout("slots_parallel", SlotsConfig(parallel=True))
register_layout("slots", SlotsConfig())
register_layout("slots_diagonal", SlotsConfig(diagonal_shift=6.0))


def centre_lines(config: SlotsConfig) -> tuple[np.ndarray, np.ndarray]:
    """Where the slots' centre lines begin and end, (slots, 2) each [m]."""
    n, length, y = config.slots_per_row, config.slot_length, config.half_corridor
    number = np.arange(n) - n // 2
    level, zero = np.full(n, y), np.zeros(n)
    if config.parallel:
        x = number * (length + GAP) + length / 2
        above = np.stack([x, level]), np.stack([x - length, level])
        below = np.stack([x - length, -level]), np.stack([x, -level])
    else:
        x, shift = number * config.slot_width - config.slot_width / 2, zero
        shift = shift + config.diagonal_shift
        above = np.stack([x, level]), np.stack([x - shift, level + length])
        below = np.stack([x + shift, -level]), np.stack([x, -level - length])
    begin, end = (
        np.concatenate(part, axis=1).T for part in zip(above, below, strict=True)
    )
    return begin, end


def _obstacles(config: SlotsConfig) -> np.ndarray:
    """Centres (k, 2) of the obstacles [m], as far apart as vertical slots."""
    if not config.obstacles:
        return np.zeros((0, 2))
    n, width = config.slots_per_row, config.slot_width
    first = -(n / 2 + MORE_OBSTACLES / 2) * width - (n % 2 == 0) * width / 2
    x = first + width * np.arange(n + MORE_OBSTACLES)
    # 19 m in the thesis, whose formula puts them into the slots of wider corridors.
    y = config.half_corridor + config.slot_length + OBSTACLE / 2
    return np.concatenate([np.stack([x, np.full_like(x, s * y)], 1) for s in (1, -1)])


def _extent(
    config: SlotsConfig, bay: np.ndarray, obstacle: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """(2,) half widths of the ground that bears everything [m]."""
    parts = (bay, config.bay_size), (obstacle, (OBSTACLE, OBSTACLE)), (start, CAR.size)
    far = []
    for pose, (length, width) in parts:
        cos, sin = np.abs(np.cos(pose[:, 2])), np.abs(np.sin(pose[:, 2]))
        half = np.stack([length * cos + width * sin, length * sin + width * cos]) / 2
        far.append(np.abs(pose[:, :2]) + half.T)
    return np.concatenate(far).max(axis=0) + MARGIN

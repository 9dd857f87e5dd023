"""Cases of the Trajectory Planning Competition for Automated Parking (TPCAP), as CSV.

A file is one flat vector, over one or several lines: start pose x0, y0, theta0, goal
pose xf, yf, thetaf, the number of obstacles n, n vertex counts, then the vertices x, y
of one obstacle after the other; metres and radians, poses of the rear axle's centre.

Conversion: the goal is the only bay, a little larger than the car; the start is
a spawn region of 2 cm. A rectangle becomes one wall. Of any other polygon, convex or
not, the edges become walls 2 cm thick on its inner side: from outside that is the
polygon to within 2 cm, and no car gets inside without crossing an edge. There are no
lanes and no outer walls. The case is moved so that the lot's centre is the origin, in
double precision: published cases lie up to 1e10 m from theirs.

The 20 published cases are in the package as they were published, with their sources
(`tpcap_cases/README.md`). The car `tpcap` has the competition's and HOPE's limits on
the chassis of `sedan_fwd`.
"""

import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import LayoutConfig, register_layout
from carpark_mj.geometry import boxes_overlap
from carpark_mj.layouts.base import LAYOUT_FORMATS
from carpark_mj.layouts.build import Group, assemble, bays, spawns, walls
from carpark_mj.layouts.files import FARTHEST
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.layouts.types import BayEnd, Layout
from carpark_mj.reading import naming_file, read_text
from carpark_mj.vehicle import PRESETS, register_vehicle
from carpark_mj.vehicle.parameters import kerb_to_kerb

# The competition's car: 0.96 m and 0.929 m beyond a wheelbase of 2.8 m, 1.942 m wide,
# full lock 0.75 rad (Li et al., Online competition of trajectory planning for automated
# parking, 2022).
TPCAP_CAR = DesignCar(
    length=0.929 + 2.8 + 0.96,
    width=1.942,
    wheelbase=2.8,
    rear_overhang=0.929,
    max_steering=0.75,
)
BAY_MARGIN = 0.2  # m on every side of the goal footprint, less where obstacles are near
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)  # of it: the first that is free; else none
EDGE = 0.02  # m, thickness of the walls along the edges of a polygon
TOUCHING = 0.01  # m by which a car may stand in an obstacle, for rounded coordinates
START = 0.02  # m, side of the spawn region
PADDED = 256  # walls, to multiples of which
LEAST_AREA = 1e-4  # m², of an obstacle
FARTHEST_ORIGIN = 1e10  # m; float64 resolves 2e-6 m there
MOST_HEADING = 4 * math.pi  # rad; published ones reach 6.1, larger are degrees
RIGHT_ANGLE = 1e-3  # cosine up to which a corner of a rectangle is right


def read_tpcap(path: Path) -> Layout:
    """Reads a TPCAP case from CSV, whose poses are of the rear axle of `TPCAP_CAR`.

    Raises:
        ValueError: no such file, or a fault in it.
    """
    with naming_file(path):
        cells = ",".join(read_text(path).splitlines()).split(",")
        numbers = list(map(_number, filter(str.strip, cells)))
        return case_layout(TPCAP_CAR, *_parts(numbers), _boxes, BAY_MARGIN)


def _number(cell: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = math.nan
    _require(math.isfinite(number), f"{cell.strip()!r} is not a number")
    return number


def _require(holds: object, message: str) -> None:
    if not holds:
        raise ValueError(message)


def _parts(numbers: list[float]) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Start and goal (3,), and the vertices (n, 2) of each obstacle."""
    there = len(numbers)
    whole = "a case begins with start, goal and the number of obstacles (7 numbers)"
    _require(there >= 7, f"{whole}, not {there}")
    count = _whole(numbers[6], "number of obstacles", 0)
    few = f"{count} obstacles need {count} vertex counts, there are {there - 7}"
    _require(there >= 7 + count, few)
    counts = enumerate(numbers[7 : 7 + count])
    sizes = [_whole(n, f"vertex count of obstacle {k}", 3) for k, n in counts]
    expected = 7 + count + 2 * sum(sizes)
    parts = f"{count} obstacles with {sum(sizes)} vertices make {expected} numbers"
    _require(there == expected, f"{parts}, not {there}")
    start, goal = np.array(numbers[:3]), np.array(numbers[3:6])
    for heading in (start[2], goal[2]):
        rule = f"a heading must be at most {MOST_HEADING:.4g} rad either way"
        _require(abs(heading) <= MOST_HEADING, f"{rule}, not {heading:g}")
    vertices = np.array(numbers[7 + count :]).reshape(-1, 2)
    points = np.concatenate([start[None, :2], goal[None, :2], vertices])
    far, away = np.abs(points).max(), np.abs(points - start[:2]).max()
    rule = "a coordinate must be at most"
    _require(far <= FARTHEST_ORIGIN, f"{rule} {FARTHEST_ORIGIN:g} m, not {far:g} m")
    most = f"{rule} {FARTHEST:g} m from the start's, not {away:g} m"
    _require(away <= FARTHEST, most)
    polygons = np.split(vertices, np.cumsum(sizes)[:-1]) if count else []
    for k, polygon in enumerate(polygons):
        told = f"obstacle {k} has no area, its {sizes[k]} vertices lie on a line or its"
        _require(abs(_area(polygon)) >= LEAST_AREA, f"{told} edges cross")
    return start, goal, polygons


def _whole(value: float, what: str, least: int) -> int:
    rule = f"{what} must be a whole number of at least {least}, not {value:g}"
    _require(value == int(value) and value >= least, rule)
    return int(value)


# Poses (n, 3) and sizes (n, 2) of boxes.
Boxes = tuple[np.ndarray, np.ndarray]


def boxes_along(
    first: np.ndarray, last: np.ndarray, thickness: float, side: float = 0.0
) -> Boxes:
    """Boxes along edges between points (n, 2), on them or to their left (`side` 1).

    Edges have a length, or `side` is 0.
    """
    along = last - first
    length = np.hypot(*along.T)
    middle = first + along / 2
    if side:
        left = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        middle = middle + side * left * thickness / 2
    yaw = np.arctan2(along[:, 1], along[:, 0])
    size = np.column_stack([length, np.full_like(length, thickness)])
    return np.column_stack([middle, yaw]), size


def case_layout(
    car: DesignCar,
    start: np.ndarray,
    goal: np.ndarray,
    shapes: Sequence[np.ndarray],
    boxes_of: Callable[[np.ndarray], Boxes],
    margin: float,
    end: BayEnd = BayEnd.EITHER,
    clears_goal: bool = False,
) -> Layout:
    """The lot of one case: walls, and a bay around the goal.

    Args:
        car: the car of the poses.
        start: (3,) pose of its rear axle.
        goal: (3,) pose of its rear axle when parked.
        shapes: points (n, 2) of each obstacle.
        boxes_of: the walls that represent an obstacle.
        margin: of the bay on every side of the car [m], less where walls are near.
        end: of the car that goes into the bay first.
        clears_goal: leave out walls that the parked car would touch.

    Raises:
        ValueError: a car would stand in an obstacle.
    """

    def centred(pose: np.ndarray) -> np.ndarray:
        step = car.centre_offset * np.array([math.cos(pose[2]), math.sin(pose[2]), 0.0])
        return pose + step

    start, goal = centred(start), centred(goal)
    reach = math.hypot(*car.size)
    around = [goal[:2] - reach, goal[:2] + reach, start[:2] - reach, start[:2] + reach]
    points = np.concatenate([np.array(around), *shapes])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = np.append((low + high) / 2, 0.0)
    boxes = [boxes_of(shape - middle[:2]) for shape in shapes]
    boxes.append((np.zeros((0, 3)), np.zeros((0, 2))))
    pose, size = (np.concatenate(part) for part in zip(*boxes, strict=True))
    start, goal = start - middle, goal - middle
    # Padded while JAX has them: cases would each be compiled on their own.
    mask = np.arange(len(pose) + -len(pose) % PADDED) < len(pose)
    padding = [(0, len(mask) - len(pose)), (0, 0)]
    solid = walls(np.pad(pose, padding), np.pad(size, padding), mask=mask)
    margins = np.array([-TOUCHING, *(share * margin for share in SHARES)])
    sizes = np.array(car.size) + 2 * margins[:, None]
    places = np.stack([start, goal, *[goal] * len(SHARES)])
    meets = np.array(_meets(places, sizes[[0, *range(len(sizes))]], solid))
    kept = np.asarray(solid["wall_mask"]).copy()
    if clears_goal:
        kept &= ~meets[-1]  # at the goal, without a margin
    blocked: np.ndarray = np.any(meets & kept, axis=-1)
    for what, stands in zip(("start", "goal"), blocked[:2], strict=True):
        _require(not stands, f"a car at the {what} would stand in an obstacle")
    free = sizes[1:][~blocked[2:]]
    bay_size = free[0] if len(free) else np.array(car.size)
    layout = assemble(
        (high - low) / 2,
        bays(goal[None], bay_size, end=end),
        solid,
        spawns(start[None], (START, START), 0.0),
    )
    rows = {name: np.asarray(column)[kept] for name, column in solid.items()}
    return dataclasses.replace(layout, **jax.tree.map(jnp.asarray, rows))


@jax.jit
def _meets(pose: jax.Array, size: jax.Array, solid: Group) -> jax.Array:
    """(n, walls) bool, whether boxes (n, 3), (n, 2) overlap a wall."""
    meets = boxes_overlap(
        pose[:, None], size[:, None], solid["wall_pose"], solid["wall_size"]
    )
    return meets & solid["wall_mask"]


def _area(polygon: np.ndarray) -> float:
    """Area of a polygon (n, 2) [m²], negative if its vertices run clockwise."""
    x, y = (polygon - polygon[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


def _boxes(polygon: np.ndarray) -> Boxes:
    """The walls that represent a polygon (n, 2)."""
    ends = np.roll(polygon, -1, axis=0)
    kept = (ends != polygon).any(axis=1)  # a repeated vertex has no edge
    polygon, ends = polygon[kept], ends[kept]
    pose, size = boxes_along(polygon, ends, EDGE, np.sign(_area(polygon)))
    turns = np.cos(np.roll(pose[:, 2], -1) - pose[:, 2])
    if len(polygon) == 4 and np.abs(turns).max() < RIGHT_ANGLE:
        middle = np.append(polygon.mean(axis=0), pose[0, 2])
        return middle[None], size[None, :2, 0]
    return pose, size


LAYOUT_FORMATS.register("csv", read_tpcap)


FOLDER = Path(__file__).with_name("tpcap_cases")
# Of the texts of the files in the order of their numbers.
SHA256 = "7ea190e8b7b5a0639d7681d573e9712b1967a77864932a7a8ca18923de95dfb3"
NUMBERS = range(1, 21)


@dataclasses.dataclass(frozen=True)
class TpcapConfig(LayoutConfig):
    """A published case of TPCAP.

    Attributes:
        case: its number, 1 to 20; None = any of them.
    """

    case: int | None = None
    family: str = "tpcap"
    is_enclosed = False  # cars can leave

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.case is not None and self.case not in NUMBERS:
            raise ValueError(
                f"case must be {NUMBERS[0]} to {NUMBERS[-1]}, not {self.case!r}"
            )

    @property
    def min_bays(self) -> int:
        """One, the goal."""
        return 1

    @property
    def is_random(self) -> bool:
        """Whether the case depends on the key."""
        return self.case is None

    def generate(self, key: jax.Array) -> Layout:
        """The layout of a case; of any, padded alike, if none is named."""
        if self.case is not None:
            return jax.tree.map(jnp.asarray, _read(self.case))
        pick = jax.random.randint(key, (), 0, len(NUMBERS))
        return jax.tree.map(lambda rows: jnp.asarray(rows)[pick], load_tpcap())


register_layout("tpcap", TpcapConfig())
for number in NUMBERS:
    register_layout(f"tpcap_{number}", TpcapConfig(number))


@functools.cache
def load_tpcap() -> Layout:
    """All cases, (20, ...) and padded alike, as numpy arrays."""
    return stack_layouts(list(map(_read, NUMBERS)))


def stack_layouts(layouts: Sequence[Layout]) -> Layout:
    """Layouts padded alike, (n, ...), as numpy arrays."""

    def stack(*parts: np.ndarray) -> np.ndarray:
        most = max(len(part) for part in parts)
        # As `pad_layout` does, which would be compiled for each case.
        more = [[(0, most - len(part)), *[(0, 0)] * (part.ndim - 1)] for part in parts]
        return np.stack(list(map(np.pad, parts, more)))

    return jax.tree.map(stack, *layouts)


@functools.cache
def _read(number: int) -> Layout:
    with jax.ensure_compile_time_eval():  # also while a program is traced
        return jax.device_get(read_tpcap(published_files()[number]))


@functools.cache
def published_files() -> dict[int, Path]:
    """The files by number, once they have been compared with the published ones."""
    files = {number: FOLDER / f"case{number}.csv" for number in NUMBERS}
    texts = [file.read_text(encoding="utf-8") for file in files.values()]
    require_published(FOLDER, "".join(texts).encode(), SHA256)
    return files


def require_published(place: Path, data: bytes, sha256: str) -> None:
    """Refuses cases of the package that were changed."""
    if (found := hashlib.sha256(data).hexdigest()) != sha256:
        raise ValueError(
            f"{place} has other cases than the published ones: their SHA-256 is "
            f"{found}, not {sha256}"
        )


_CHASSIS = PRESETS["sedan_fwd"]
_SIZES = ("length", "width", "wheelbase", "rear_overhang")
register_vehicle(
    "tpcap",
    dataclasses.replace(
        _CHASSIS,
        **{name: getattr(TPCAP_CAR, name) for name in _SIZES},
        turning_circle=kerb_to_kerb(
            TPCAP_CAR.wheelbase,
            _CHASSIS.track_width,
            _CHASSIS.tyre_width,
            TPCAP_CAR.max_steering,
        ),
        max_acceleration=1.0,
        max_speed=2.5,
        max_reverse_speed=2.5,
        steering_rate=0.5,
    ),
)

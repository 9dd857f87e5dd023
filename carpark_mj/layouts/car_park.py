"""Real car parks by name, and parts of lots."""

import contextlib
import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import require_name
from carpark_mj.geometry import box_corners, point_box_distance
from carpark_mj.layouts.base import LayoutConfig, register_layout
from carpark_mj.layouts.files import read_json
from carpark_mj.layouts.registry import FixedLayoutConfig
from carpark_mj.layouts.routes import make_routes
from carpark_mj.layouts.types import ROWS, Layout, layout_maxima, pad_layout

SHORTEST = 1.0  # m of what is left of a lane
ASIDE = 1.0  # m that the lane in front of a bay may be farther away in the part
THINNEST = 0.05  # m of what is left of a wall or a spawn region
DRAWS = 100  # of parts, for each that is found


def crop(layout: Layout, corners: tuple[float, ...]) -> Layout:
    """The part of a lot between two corners, x, y, x and y [m], about its middle.

    Bays and discs are kept whole or not at all, bays only with the lane in front of
    them; walls, lanes and spawn regions end where their centre lines leave the part.
    The arrays, without a batch dimension, become numpy's.

    Raises:
        ValueError: the part has no bay, or no spawn region.
    """
    low, high = np.sort(np.array(corners, float).reshape(2, 2), axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    plan: Any = jax.device_get(layout)
    fields: dict[str, Any] = {
        name: np.array(array) for name, array in vars(plan).items() if array is not None
    }
    bays = np.asarray(box_corners(plan.bay_pose, plan.bay_size))
    masks = {
        "bay": (np.abs(bays - middle) <= half).all(axis=(-2, -1)),
        "disc": (np.abs(plan.disc_centre - middle) <= half).all(axis=-1),
    }
    for row, least in (("wall", THINNEST), ("lane", SHORTEST), ("spawn", THINNEST)):
        pose, size = fields[f"{row}_pose"], fields[f"{row}_size"]
        back, front = _within(pose, size[:, 0], low, high)
        pose[:, :2] += _ahead(pose) * ((back + front) / 2)[:, None]
        masks[row] = front - back > np.minimum(least, size[:, 0] / 2)
        size[:, 0] = front - back
    if len(plan.lane_mask):
        cut = fields["lane_pose"], fields["lane_size"], masks["lane"] & plan.lane_mask
        before = _to_lane(plan, plan.lane_pose, plan.lane_size, plan.lane_mask)
        masks["bay"] = masks["bay"] & (_to_lane(plan, *cut) < before + ASIDE)
    for row in ROWS:
        keep = fields[f"{row}_mask"] & masks[row]
        for name in fields:
            if name.startswith(f"{row}_"):
                fields[name] = fields[name][keep]
        for part in ("pose", "centre"):
            if f"{row}_{part}" in fields:
                fields[f"{row}_{part}"][:, :2] -= middle.astype(np.float32)
    fields["extent"] = half.astype(np.float32)
    for row, what in (("bay", "whole bay"), ("spawn", "spawn region")):
        if not len(fields[f"{row}_mask"]):
            raise ValueError(
                f"there is no {what} between the corners {tuple(low.tolist())} and "
                f"{tuple(high.tolist())}; the lot reaches from "
                f"{(-plan.extent).tolist()} to {plan.extent.tolist()}"
            )
    return Layout(**fields)


def _ahead(pose: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 2) of headings."""
    return np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)


def _to_lane(plan: Any, pose: Any, size: Any, mask: np.ndarray) -> np.ndarray:
    """Distance (bays,) from the front end of each bay to the nearest lane [m]."""
    front = plan.bay_pose[:, :2] + plan.bay_size[:, :1] / 2 * _ahead(plan.bay_pose)
    gap = np.asarray(point_box_distance(front, pose[:, None], size[:, None]))
    return np.where(mask[:, None], gap, np.inf).min(axis=0)


def _within(
    pose: np.ndarray, length: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part of each centre line in a rectangle, from its middle [m]."""
    ahead = _ahead(pose)
    ahead = np.where(np.abs(ahead) < 1e-9, 1e-9, ahead)
    first, second = (low - pose[:, :2]) / ahead, (high - pose[:, :2]) / ahead
    back = np.maximum(np.minimum(first, second).max(axis=1), -length / 2)
    front = np.minimum(np.maximum(first, second).min(axis=1), length / 2)
    return back, front


# What they are made of, their sources and licences: README.md beside the files.
DATA = Path(__file__).parent / "data"
CAR_PARKS = ("dragon_lake", "san_jose")


@dataclasses.dataclass(frozen=True)
class CarParkConfig(FixedLayoutConfig):
    """A real car park, read when it is first used.

    Attributes:
        name: `dragon_lake` or `san_jose`.
        corners: x and y of two opposite corners of the part to take [m], in the frame
            of the whole; empty = all of it.
    """

    name: str = "dragon_lake"
    corners: tuple[float, ...] = ()
    family: str = "car_park"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_name("car park", self.name, CAR_PARKS)
        if len(self.corners) not in (0, 4):
            raise ValueError(
                f"corners must be x, y, x and y, or nothing, not {self.corners}"
            )

    def crop(self, x: float, y: float, other_x: float, other_y: float) -> LayoutConfig:
        """The part between two corners [m]."""
        return dataclasses.replace(self, corners=(x, y, other_x, other_y))

    @property
    def layout(self) -> Layout:
        """The lot, as numpy arrays."""
        return _made(self.name, self.corners)


@functools.cache
def _made(name: str, corners: tuple[float, ...]) -> Layout:
    """The lot of a config, made once."""
    with jax.ensure_compile_time_eval():  # may be called by a function that is traced
        whole = jax.device_get(read_json(DATA / f"{name}.json"))
        return crop(whole, corners) if corners else whole


def random_parts(
    name: str, size: tuple[float, float], count: int, seed: int = 0, min_bays: int = 16
) -> list[CarParkConfig]:
    """Draws parts of a car park in which every bay has a route from every lane.

    Each has a size in x and y [m] and at least `min_bays`. `ValueError` if there are
    hardly any such parts.
    """
    config, generator = CarParkConfig(name), np.random.default_rng(seed)
    whole, found, half = config.layout, [], np.array(size) / 2
    maxima, room = layout_maxima([whole]), whole.extent - half
    for _ in range(DRAWS * count if (room > 0).all() else 0):
        middle = generator.uniform(-room, room)
        corners = (*(middle - half), *(middle + half))
        part = dataclasses.replace(config, corners=tuple(map(float, corners)))
        with contextlib.suppress(ValueError):  # no bay or nowhere to start
            enough = part.min_bays >= min_bays
            if enough and _all_reached(pad_layout(part.layout, maxima)):
                found.append(part)
        if len(found) == count:
            return found
    raise ValueError(
        f"{name} has too few parts of {size[0]:g} m x {size[1]:g} m with at least "
        f"{min_bays} bays that all have routes; choose another size"
    )


@jax.jit
def _all_reached(layout: Layout) -> jax.Array:
    """() bool, whether every bay has a route from every lane."""
    routes = make_routes(layout)
    reached = routes.beside | jnp.isfinite(routes.remaining).any(axis=1)
    return jnp.all(reached | ~layout.lane_mask[:, None] | ~layout.bay_mask)


for _name in CAR_PARKS:
    register_layout(_name, CarParkConfig(_name))

"""Real car parks by name, and parts of them."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.layouts import LayoutConfig, register_layout
from carpark_mj.layouts.crop import crop
from carpark_mj.layouts.dragon_lake import dragon_lake
from carpark_mj.layouts.fixed import FixedLayoutConfig
from carpark_mj.layouts.json_file import read_json
from carpark_mj.layouts.routes import make_routes
from carpark_mj.layouts.types import Layout, layout_maxima, pad_layout

DRAWS = 100  # of parts, for each that is found

CAR_PARKS: dict[str, Callable[[], Layout]] = {
    "dragon_lake": jax.jit(dragon_lake),
    # What it is made of, its source and licence: README.md beside it.
    "san_jose": lambda: read_json(Path(__file__).parent / "data" / "san_jose.json"),
}


@dataclasses.dataclass(frozen=True)
class CarParkConfig(FixedLayoutConfig):
    """A real car park, read when it is first used.

    Attributes:
        name: `dragon_lake` or `san_jose`.
        corners: x and y of two opposite corners of the part to take [m], in the frame
            of the whole; empty = all of it.
        family: fixed.
    """

    name: str = "dragon_lake"
    corners: tuple[float, ...] = ()
    family: str = "car_park"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.name not in CAR_PARKS:
            raise ValueError(
                f"unknown car park {self.name!r}; choose from {sorted(CAR_PARKS)}"
            )
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
        whole = jax.device_get(CAR_PARKS[name]())
        if not corners:
            return whole
        x, y, other_x, other_y = corners
        return crop(whole, (x, y, other_x, other_y))


def random_parts(
    name: str, size: tuple[float, float], count: int, seed: int = 0, min_bays: int = 16
) -> list[CarParkConfig]:
    """Draws parts of a car park in which every bay has a route from every lane.

    Args:
        name: of the car park.
        size: of each part in x and y [m].
        count: how many.
        seed: of the draws.
        min_bays: that each has at least.

    Raises:
        ValueError: an unknown car park, or hardly any such part in it.
    """
    config, generator = CarParkConfig(name), np.random.default_rng(seed)
    whole, found, half = config.layout, [], np.array(size) / 2
    maxima, room = layout_maxima([whole]), whole.extent - half
    for _ in range(DRAWS * count if (room > 0).all() else 0):
        middle = generator.uniform(-room, room)
        corners = (*(middle - half), *(middle + half))
        part = config.crop(*map(float, corners))
        try:
            enough = part.min_bays >= min_bays
        except ValueError:  # no bay or nowhere to start
            continue
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


DRAGON_LAKE = register_layout("dragon_lake", CarParkConfig("dragon_lake"))
SAN_JOSE = register_layout("san_jose", CarParkConfig("san_jose"))

"""Real car parks by name, and parts of them."""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp

from carpark_mj.config.layouts import LayoutConfig, register_layout
from carpark_mj.layouts.crop import crop
from carpark_mj.layouts.dragon_lake import dragon_lake
from carpark_mj.layouts.json_file import read_json
from carpark_mj.layouts.types import Layout

_MAKERS: dict[str, Callable[[], Layout]] = {
    "dragon_lake": jax.jit(dragon_lake),
    # What it is made of, its source and licence: README.md beside it.
    "san_jose": lambda: read_json(Path(__file__).parent / "data" / "san_jose.json"),
}


@dataclasses.dataclass(frozen=True)
class CarParkConfig(LayoutConfig):
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
        if self.name not in _MAKERS:
            raise ValueError(
                f"unknown car park {self.name!r}; choose from {sorted(_MAKERS)}"
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

    @property
    def is_enclosed(self) -> bool:
        """No: not all of the ground is within walls."""
        return False

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        return int(self.layout.bay_mask.sum())

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
        return False

    def generate(self, key: jax.Array) -> Layout:
        """The lot; the key is unused."""
        del key
        return jax.tree.map(jnp.asarray, self.layout)


@functools.cache
def _made(name: str, corners: tuple[float, ...]) -> Layout:
    """The lot of a config, made once."""
    with jax.ensure_compile_time_eval():  # may be called by a function that is traced
        whole = jax.device_get(_MAKERS[name]())
        if not corners:
            return whole
        x, y, other_x, other_y = corners
        return crop(whole, (x, y, other_x, other_y))


DRAGON_LAKE = register_layout("dragon_lake", CarParkConfig("dragon_lake"))
SAN_JOSE = register_layout("san_jose", CarParkConfig("san_jose"))

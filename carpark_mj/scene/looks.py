"""How things look: colours, surfaces, and the silhouettes of cars.

Shares of silhouettes are read off side views of the models in `vehicle.presets` by eye;
they have no effect on the physics.
"""

import dataclasses
import math
from typing import Any

import mujoco

from carpark_mj.vehicle.parameters import VehicleParameters
from carpark_mj.vehicle.presets import PRESETS

Colour = tuple[float, float, float, float]

ASPHALT = (0.23, 0.24, 0.26, 1.0)
LINE = (0.93, 0.93, 0.90, 1.0)
CONCRETE = (0.62, 0.61, 0.58, 1.0)
KERB = (0.72, 0.72, 0.70, 1.0)
GREEN = (0.36, 0.45, 0.30, 1.0)
GRASS = (0.32, 0.38, 0.27, 1.0)
GATE = (0.80, 0.35, 0.15, 1.0)
MOVER = (0.95, 0.72, 0.08, 1.0)
SKIN = (0.86, 0.67, 0.55, 1.0)
TROUSERS = (0.16, 0.19, 0.28, 1.0)
COATS = (  # of people, taken in turn
    (0.82, 0.22, 0.20, 1.0),
    (0.90, 0.62, 0.12, 1.0),
    (0.16, 0.55, 0.62, 1.0),
    (0.62, 0.28, 0.58, 1.0),
    (0.88, 0.86, 0.80, 1.0),
)
ZENITH = (0.45, 0.58, 0.72, 1.0)
HORIZON = (0.80, 0.84, 0.87, 1.0)
GLASS = (0.10, 0.13, 0.17, 1.0)
TRIM = (0.09, 0.09, 0.10, 1.0)
SHADE = (0.0, 0.0, 0.0, 0.17)  # of one of the sheets below a car
TYRE = (0.06, 0.06, 0.06, 1.0)
RIM = (0.70, 0.71, 0.73, 1.0)
HEADLIGHT = (0.98, 0.98, 0.95, 1.0)
TAIL_LIGHT = (0.75, 0.05, 0.05, 1.0)

# Greys of parked cars, taken in turn.
PARKED = (
    (0.80, 0.81, 0.82, 1.0),
    (0.55, 0.56, 0.58, 1.0),
    (0.38, 0.39, 0.41, 1.0),
    (0.67, 0.66, 0.63, 1.0),
)

# Agents: ten hues that stay apart, also for most colour-blind viewers (Tol, "bright"
# and "vibrant" schemes), taken in turn.
AGENTS = (
    (0.27, 0.47, 0.85, 1.0),
    (0.93, 0.47, 0.20, 1.0),
    (0.13, 0.65, 0.30, 1.0),
    (0.80, 0.73, 0.27, 1.0),
    (0.67, 0.20, 0.47, 1.0),
    (0.40, 0.80, 0.93, 1.0),
    (0.93, 0.20, 0.30, 1.0),
    (0.55, 0.40, 0.85, 1.0),
    (0.93, 0.55, 0.70, 1.0),
    (0.00, 0.60, 0.53, 1.0),
)


def agent_colour(agent: int) -> Colour:
    """RGBA of an agent, by index."""
    return AGENTS[agent % len(AGENTS)]


def rgb(colour: tuple[float, ...]) -> tuple[int, int, int]:
    """Red, green and blue from 0 to 255."""
    r, g, b = (round(255 * c) for c in colour[:3])
    return r, g, b


# Geoms that are only seen, and paint, which casts no shadows either.
VISUAL: dict[str, Any] = {"contype": 0, "conaffinity": 0, "group": 1}
PAINT: dict[str, Any] = {**VISUAL, "rgba": LINE, "castshadow": False}

# Specular, shininess and emission.
_SURFACES = {
    "paint": (0.3, 0.6, 0.0),
    "glass": (0.9, 0.9, 0.0),
    "metal": (0.6, 0.5, 0.0),
    "rubber": (0.1, 0.1, 0.0),
    "lamp": (0.5, 0.5, 0.35),
}


def add_materials(spec: mujoco.MjSpec) -> None:
    """Adds the surfaces of cars; their colours are the geoms' own."""
    for name, (specular, shininess, emission) in _SURFACES.items():
        spec.add_material(
            name=name, specular=specular, shininess=shininess, emission=emission
        )


Line = tuple[tuple[float, float], ...]


@dataclasses.dataclass(frozen=True)
class CarStyle:
    """A side view; points are (share of length behind the nose, share of height)."""

    # the body's upper edge from nose to tail: shares of length and of height
    along: tuple[float, ...]
    top: tuple[float, ...]
    # foot of the windscreen, front and rear end of the roof, foot of the rear window
    windows: Line
    pillars: Line  # from and to, as shares of a side window's length
    roof: float = 0.72  # half width of the roof over half width of the car
    clearance: float = 0.17  # of the sills above the ground [m]
    tall_lights: bool = True  # beside the rear window; else lying


STYLES = {
    "city": CarStyle(
        along=(0.0, 0.02, 0.08, 0.25, 0.90, 0.97, 1.0),
        top=(0.44, 0.52, 0.575, 0.645, 0.65, 0.62, 0.54),
        windows=((0.235, 0.64), (0.43, 0.965), (0.80, 0.955), (0.955, 0.64)),
        pillars=((0.0, 0.035), (0.54, 0.64), (0.90, 1.0)),
        roof=0.70,
    ),
    "compact": CarStyle(
        along=(0.0, 0.02, 0.08, 0.26, 0.93, 0.98, 1.0),
        top=(0.46, 0.525, 0.575, 0.655, 0.67, 0.65, 0.56),
        windows=((0.25, 0.65), (0.43, 0.965), (0.86, 0.955), (0.962, 0.66)),
        pillars=((0.0, 0.035), (0.44, 0.50), (0.82, 1.0)),
    ),
    "sedan": CarStyle(
        along=(0.0, 0.02, 0.08, 0.28, 0.82, 0.97, 1.0),
        top=(0.45, 0.52, 0.575, 0.655, 0.69, 0.675, 0.58),
        windows=((0.27, 0.65), (0.43, 0.965), (0.67, 0.955), (0.835, 0.68)),
        pillars=((0.0, 0.035), (0.46, 0.52), (0.90, 1.0)),
        roof=0.70,
        tall_lights=False,
    ),
    "sedan_fwd": CarStyle(
        along=(0.0, 0.02, 0.08, 0.27, 0.85, 0.975, 1.0),
        top=(0.45, 0.52, 0.58, 0.66, 0.70, 0.69, 0.60),
        windows=((0.26, 0.655), (0.42, 0.965), (0.68, 0.955), (0.865, 0.69)),
        pillars=((0.0, 0.035), (0.44, 0.50), (0.90, 1.0)),
        roof=0.72,
        tall_lights=False,
    ),
    "suv": CarStyle(
        along=(0.0, 0.015, 0.07, 0.26, 0.94, 0.985, 1.0),
        top=(0.50, 0.575, 0.615, 0.665, 0.68, 0.66, 0.58),
        windows=((0.25, 0.66), (0.40, 0.965), (0.88, 0.955), (0.968, 0.67)),
        pillars=((0.0, 0.035), (0.42, 0.47), (0.74, 0.79), (0.94, 1.0)),
        roof=0.77,
        clearance=0.22,
    ),
    "van": CarStyle(
        along=(0.0, 0.015, 0.05, 0.17, 0.95, 0.99, 1.0),
        top=(0.42, 0.475, 0.505, 0.565, 0.575, 0.57, 0.53),
        windows=((0.15, 0.56), (0.29, 0.965), (0.95, 0.96), (0.968, 0.57)),
        pillars=((0.0, 0.035), (0.32, 0.5), (0.5, 0.75), (0.75, 1.0)),
        roof=0.86,
        clearance=0.20,
    ),
}


def nearest_style(params: VehicleParameters) -> str:
    """Name of the style whose preset is most like a car in length, width and height."""

    def difference(name: str) -> float:
        other = PRESETS[name]
        return sum(
            math.log(getattr(params, side) / getattr(other, side)) ** 2
            for side in ("length", "width", "height")
        )

    return min(STYLES, key=difference)

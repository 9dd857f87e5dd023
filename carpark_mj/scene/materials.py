"""Colours of the scene, RGBA in [0, 1], and how surfaces shine."""

import mujoco

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

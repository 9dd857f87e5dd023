"""The roads: lanes as paths, their connections, and the asphalt.

An unsignalised T-junction with one lane per direction; arms to the west, east and
south; traffic keeps to the right. It is SMARTS's scenario `zoo_intersection`
(huawei-noah/SMARTS, `scenarios/sumo/zoo_intersection/map.net.xml`), of which Cederle
2023 has a copy. The world frame's origin is the middle of the junction: SUMO's
coordinates less (100, 100). Lengths are in metres.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

SPEED_LIMIT = 13.89  # m/s, 50 km/h
LANE_WIDTH = 3.2  # SUMO's default
LANE_OFFSET = 1.65  # centre line of a lane from the road's axis
HALF_ROAD = 3.25  # kerb from the road's axis
CORNER = 1.5  # radius of the kerb at the two corners of the south arm
WEST, EAST, SOUTH = -38.54, 38.22, -39.02  # where the arms end

Point = tuple[float, float]
Path = tuple[Point, ...]

# Named as in SUMO: the arm, then the direction of travel.
LANES: dict[str, Path] = {
    "east-EW": ((38.22, 1.65), (4.75, 1.65)),
    "east-WE": ((4.75, -1.65), (38.22, -1.65)),
    "south-NS": ((-1.65, -4.75), (-1.65, -39.02)),
    "south-SN": ((1.65, -39.02), (1.65, -4.75)),
    "west-EW": ((-4.75, 1.65), (-38.54, 1.65)),
    "west-WE": ((-38.54, -1.65), (-4.75, -1.65)),
}

# Paths across the junction, from the end of a lane to the start of another.
CONNECTIONS: dict[tuple[str, str], Path] = {
    ("east-EW", "west-EW"): ((4.75, 1.65), (-4.75, 1.65)),
    ("east-EW", "south-NS"): (
        (4.75, 1.65),
        (1.95, 1.25),
        (-0.05, 0.05),
        (-0.11, -0.05),
        (-1.25, -1.95),
        (-1.65, -4.75),
    ),
    ("south-SN", "east-WE"): (
        (1.65, -4.75),
        (1.84, -3.39),
        (2.43, -2.43),
        (3.39, -1.84),
        (4.75, -1.65),
    ),
    ("south-SN", "west-EW"): (
        (1.65, -4.75),
        (1.25, -1.95),
        (0.05, 0.05),
        (-1.95, 1.25),
        (-4.75, 1.65),
    ),
    ("west-WE", "south-NS"): (
        (-4.75, -1.65),
        (-3.39, -1.84),
        (-2.43, -2.43),
        (-1.84, -3.39),
        (-1.65, -4.75),
    ),
    ("west-WE", "east-WE"): ((-4.75, -1.65), (4.75, -1.65)),
}


class Box(NamedTuple):
    """An upright rectangle of asphalt or paint.

    Attributes:
        centre: (x, y).
        size: extent in x and in y.
    """

    centre: Point
    size: Point


# The asphalt but for the two rounded corners: the road from west to east, the south arm
# and the corners' squares, of which `CORNER_CENTRES` are cut out.
_ARM = (SOUTH - HALF_ROAD) / 2
ROAD = (
    Box(((WEST + EAST) / 2, 0.0), (EAST - WEST, 2 * HALF_ROAD)),
    Box((0.0, _ARM), (2 * HALF_ROAD, -SOUTH - HALF_ROAD)),
    *(
        Box(
            (side * (HALF_ROAD + CORNER / 2), -HALF_ROAD - CORNER / 2), (CORNER, CORNER)
        )
        for side in (-1, 1)
    ),
)
CORNER_CENTRES = tuple(
    (side * (HALF_ROAD + CORNER), -HALF_ROAD - CORNER) for side in (-1, 1)
)

# Paint: a line between the directions of every arm, and the main road's southern edge
# broken at the arm. Widths are those of German markings (RMS-1), a broad 0.25 m stop
# line and thin lines of 0.12 m.
MOUTH = HALF_ROAD + CORNER  # where the arms begin
LINE, STOP_LINE = 0.12, 0.25
MARKINGS = (
    Box(((WEST - MOUTH) / 2, 0.0), (-WEST - MOUTH, LINE)),
    Box(((EAST + MOUTH) / 2, 0.0), (EAST - MOUTH, LINE)),
    Box((0.0, (SOUTH - MOUTH) / 2), (LINE, -SOUTH - MOUTH)),
    Box((LANE_OFFSET, -MOUTH), (LANE_WIDTH, STOP_LINE)),
)


def path_length(path: Path) -> float:
    """Length of a polyline [m]."""
    return float(np.hypot(*np.diff(np.asarray(path), axis=0).T).sum())


def on_road(xy: jax.Array) -> jax.Array:
    """Whether points (..., 2) [m] are on asphalt, (...) bool; an edge is.

    Beyond the ends of the arms the roads go on.
    """
    xy = jnp.stack(
        [jnp.clip(xy[..., 0], WEST, EAST), jnp.maximum(xy[..., 1], SOUTH)], axis=-1
    )
    boxes = jnp.array([(*box.centre, *box.size) for box in ROAD], jnp.float32)
    off = jnp.abs(xy[..., None, :] - boxes[:, :2]) - boxes[:, 2:] / 2
    inside = (off <= 0.0).all(axis=-1).any(axis=-1)
    corners = jnp.array(CORNER_CENTRES, jnp.float32)
    delta = xy[..., None, :] - corners
    cut = (delta * delta).sum(axis=-1) < CORNER * CORNER
    # A corner's disc also reaches over the grass, which is no asphalt anyway.
    return inside & ~cut.any(axis=-1)

"""The roads of the junction, and the routes along them.

An unsignalised T-junction with one lane per direction; arms to the west, east and
south; traffic keeps to the right. It is SMARTS's scenario `zoo_intersection`
(huawei-noah/SMARTS, `scenarios/sumo/zoo_intersection/map.net.xml`), of which Cederle
2023 has a copy. The world frame's origin is the middle of the junction: SUMO's
coordinates less (100, 100). Lengths are in metres.

Distances along a route count from the start of its first lane. A route goes on straight
beyond both of its ends.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.geometry import norm

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
    """An upright rectangle of asphalt or paint."""

    centre: Point  # (x, y)
    size: Point  # extent in x and in y


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
# broken at the arm. Widths follow German markings (RMS-1), a broad 0.25 m stop
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


# A car slows down for curves to what SMARTS allows where the road is most curved (its
# `lane_following_controller.py`), and in tighter ones to a lateral acceleration that
# tyres bear; [est], comfort ends at about 4 m/s^2, a dry road at about 9.
CURVE_SPEED = 5.56  # m/s, 20 km/h
MAX_LATERAL = 5.0  # m/s^2


@struct.dataclass
class Routes:
    """Routes (...) as polylines of k points; short ones repeat their last point."""

    points: jax.Array  # (..., k, 2) world frame [m]
    along: jax.Array  # (..., k) distance of the points along the route [m]
    # (..., 2) distances at which the path across the junction begins and ends [m]
    curve: jax.Array
    # (...) highest speed on that path [m/s]; inf if it is straight
    curve_speed: jax.Array
    length: jax.Array  # (...) of the whole route [m]


@dataclasses.dataclass(frozen=True)
class Route:
    """From a lane into another."""

    start: str  # name of the first lane, of `roads.LANES`
    end: str  # name of the last one

    def __post_init__(self) -> None:
        if (self.start, self.end) not in CONNECTIONS:
            ways = sorted(f"{a} to {b}" for a, b in CONNECTIONS)
            raise ValueError(
                f"no way leads from lane {self.start!r} to lane {self.end!r}; choose "
                f"from {ways}"
            )

    @property
    def points(self) -> np.ndarray:
        """The polyline (k, 2) [m]."""
        middle = CONNECTIONS[self.start, self.end]
        return np.array([LANES[self.start][0], *middle, LANES[self.end][1]])

    @property
    def curve(self) -> tuple[float, float]:
        """Where the path across the junction begins and ends [m]."""
        begin = path_length(LANES[self.start])
        return begin, begin + path_length(CONNECTIONS[self.start, self.end])

    @property
    def curve_speed(self) -> float:
        """Highest speed on the path across the junction [m/s]; inf if straight."""
        (x0, y0), (x1, y1) = (CONNECTIONS[self.start, self.end][k] for k in (0, -1))
        # All turns are right angles: the circle's radius is the side of the square.
        radius = min(abs(x1 - x0), abs(y1 - y0))
        if radius == 0.0:
            return np.inf
        return min(CURVE_SPEED, float(np.sqrt(MAX_LATERAL * radius)))


def stack_routes(routes: list[Route]) -> Routes:
    """The arrays (len(routes), ...) of some routes."""
    most = max(len(route.points) for route in routes)
    points, along = [], []
    for route in routes:
        line = route.points
        line = np.pad(line, ((0, most - len(line)), (0, 0)), mode="edge")
        steps = np.hypot(*np.diff(line, axis=0).T)
        points.append(line)
        along.append(np.concatenate([[0.0], np.cumsum(steps)]))
    length = np.array(along)[:, -1]
    columns = (
        points,
        along,
        [route.curve for route in routes],
        [route.curve_speed for route in routes],
        length,
    )
    return Routes(*(jnp.array(np.asarray(column), jnp.float32) for column in columns))


def point_at(routes: Routes, along: jax.Array) -> jax.Array:
    """Points (..., 2) [m] at distances (...) along routes (...)."""
    # The last segment that begins before: padding begins at the end of the route.
    begins = routes.along[..., :-1]
    real = jnp.diff(routes.along, axis=-1) > 0.0
    passed = real & (along[..., None] >= begins)
    passed = passed.at[..., 0].set(True)
    index = passed.shape[-1] - 1 - jnp.argmax(passed[..., ::-1], axis=-1)
    start, way = _take(routes.points, index), _take(routes.points, index + 1)
    begin = jnp.take_along_axis(routes.along, index[..., None], -1)[..., 0]
    delta = way - start
    share = (along - begin) / norm(delta)
    return start + share[..., None] * delta


def project(routes: Routes, xy: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The nearest points of routes (...) to points (..., 2) [m].

    Returns:
        Their distances along the routes (...), not beyond the ends, and the distances
        (...) of the points from them, left of the route positive [m].
    """
    start, delta = routes.points[..., :-1, :], jnp.diff(routes.points, axis=-2)
    span = norm(delta)
    real = span > 0.0
    way = delta / jnp.where(real, span, 1.0)[..., None]
    off = xy[..., None, :] - start
    share = jnp.clip((off * way).sum(axis=-1), 0.0, span)
    gap = norm(off - share[..., None] * way)
    best = jnp.argmin(jnp.where(real, gap, jnp.inf), axis=-1)[..., None]

    def pick(values: jax.Array) -> jax.Array:
        return jnp.take_along_axis(values, best, -1)[..., 0]

    left = way[..., 0] * off[..., 1] - way[..., 1] * off[..., 0]
    along = pick(routes.along[..., :-1] + share)
    return along, jnp.where(pick(left) < 0.0, -1.0, 1.0) * pick(gap)


def heading_at(routes: Routes, along: jax.Array, span: jax.Array) -> jax.Array:
    """Directions (...) [rad] of the chords of length about `span` (...) about a point.

    A car whose axles are `span` apart and both on the path points like this.
    """
    chord = point_at(routes, along + span / 2) - point_at(routes, along - span / 2)
    return jnp.arctan2(chord[..., 1], chord[..., 0])


def speed_cap(routes: Routes, along: jax.Array, braking: float) -> jax.Array:
    """Speeds (...) [m/s] from which cars at `along` (...) can slow down for the curve.

    `braking` is their deceleration before it [m/s^2]; inf behind the curve and on
    straight routes.
    """
    ahead = jnp.maximum(routes.curve[..., 0] - along, 0.0)
    cap = jnp.sqrt(routes.curve_speed**2 + 2.0 * braking * ahead)
    return jnp.where(along < routes.curve[..., 1], cap, jnp.inf)


def _take(points: jax.Array, index: jax.Array) -> jax.Array:
    """Points (..., 2) by index (...) of (..., k, 2)."""
    return jnp.take_along_axis(points, index[..., None, None], -2)[..., 0, :]

"""Car parks of several aisles with a row of bays on either side of each.

Rows of neighbouring aisles stand back to back. A cross aisle runs along both ends of
the aisles, entrances lead into the cross aisles through the outer walls, and a gate
closes each of them, so that no car leaves the lot.
"""

import dataclasses
import math
from typing import Annotated, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config.checks import Bounds, IntRange, Natural, Range
from carpark_mj.geometry import move_forward
from carpark_mj.layouts import build, standards
from carpark_mj.layouts.base import LayoutConfig, register_layout
from carpark_mj.layouts.standards import DesignCar, Entry
from carpark_mj.layouts.types import BayKind, DiscKind, Layout, WallKind

ENTRANCE_LENGTH = 7.0  # m, from the outer wall to the gate: longer than a car
ENTRANCE_WIDTH = 6.0  # m, two lanes
# m between the bays beside a pillar
PILLAR_GAP = 2 * (standards.PILLAR_RADIUS + standards.PILLAR_CLEARANCE)
BOLLARD_INSET = 0.4  # m from the ends of a row's last strip
SLACK = 1e-3  # m, tolerance for bays that fit exactly


@dataclasses.dataclass(frozen=True)
class LotConfig(LayoutConfig):
    """A car park, drawn from these ranges; lengths [m].

    Attributes:
        num_aisles: range of the number of aisles.
        bays_per_row: bays of standard width in a row.
        angle: between aisle and bays [deg], 30 to 90.
        two_way: two lanes in each aisle, bays at 90 deg only; otherwise aisles are
            one-way, in alternating directions.
        back_in: angled bays are made for backing in, not for driving in.
        bay_width: across a parked car, standard bays.
        bay_length: along a parked car.
        extra_aisle: width of the aisles beyond the standard's for the angle.
        cross_aisle: width of the cross aisles.
        num_accessible: wide bays for disabled drivers next to the first entrance.
        num_family: wide bays for families after the accessible ones.
        row_ends: what protects the last cars of a row.
        pillar_every: bays between pillars, as in a parking deck; 0 = no pillars.
        num_entrances: one, or a second one at the far end.
        boundary: what surrounds the lot.
        car: the car the lot is drawn for.
    """

    num_aisles: standards.Counts = (2, 3)
    bays_per_row: standards.Counts = (6, 10)
    angle: Annotated[Range, Bounds(ge=30.0, le=90.0, unit="deg")] = (90.0, 90.0)
    two_way: bool = True
    back_in: bool = False
    bay_width: standards.Lengths = standards.BAY_WIDTH
    bay_length: standards.Lengths = standards.BAY_LENGTH
    extra_aisle: Annotated[Range, Bounds(ge=-3.0, unit="m")] = (-1.0, 0.0)
    cross_aisle: standards.Lengths = standards.TWO_WAY_AISLE
    num_accessible: Natural = 2
    num_family: Natural = 1
    row_ends: Literal["islands", "bollards", "open"] = "islands"
    pillar_every: Natural = 0
    num_entrances: Annotated[IntRange, Bounds(ge=1, le=2)] = (1, 2)
    boundary: Literal["wall", "kerb"] = "wall"
    car: DesignCar = dataclasses.field(default_factory=DesignCar)
    family: str = "lot"

    def __post_init__(self) -> None:
        super().__post_init__()
        build.require_least(self, self.car.width, "bay_width")
        build.require_least(self, self.car.length, "bay_length")
        build.require_least(self, 2 * build.least_lane(self.car), "cross_aisle")
        if self.two_way and self.angle[0] < 90.0:
            raise ValueError(
                f"two_way needs perpendicular bays, angle (90, 90), not {self.angle}"
            )
        row = self.bays_per_row[0] * self.bay_width[0]
        if self._wide > row:
            raise ValueError(
                f"num_accessible and num_family need {self._wide} m, a row may have no "
                f"more than {row:.2f} m"
            )
        lane = build.least_lane(self.car) * (2 if self.two_way else 1)
        for entry in self._entries(self.extra_aisle[0], self.bay_width[0]):
            build.require_aisle(round(entry.aisle, 3), max(entry.least(self.car), lane))

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        low, width = self.bays_per_row[0], self.bay_width[0]
        kept = math.floor((low * width - self._wide) / width + 1e-6)
        wide = self.num_accessible + self.num_family
        return wide + kept + (2 * self.num_aisles[0] - 1) * low

    @property
    def _wide(self) -> float:
        """Width of the wide bays together [m]."""
        accessible = self.num_accessible * standards.ACCESSIBLE_WIDTH
        return accessible + self.num_family * standards.FAMILY_WIDTH

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The roomiest entries into bays of standard width, by angle."""
        return self._entries(self.extra_aisle[1], self.bay_width[1])

    def _entries(self, extra_aisle: float, bay_width: float) -> tuple[Entry, ...]:
        # Neither the standard nor the least aisle is monotonic between the ends.
        angles, standard = np.linspace(*self.angle, 25), standards.one_way_aisle
        return tuple(
            Entry(standard(a) + extra_aisle, bay_width, a) for a in angles.tolist()
        )

    def generate(self, key: jax.Array) -> Layout:
        """Draws a car park whose aisles run along x; the first entrance is at -x."""
        plan = _draw_plan(self, key)
        return build.assemble(
            plan.half + jnp.array([ENTRANCE_LENGTH, 0.0]),
            *_rows(self, plan),
            *_outer_walls(self, plan),
            *_lanes(self, plan),
        )


@dataclasses.dataclass(frozen=True)
class AngledConfig(LotConfig):
    """Rows of angled bays on one-way aisles, nose-in or back-in; see `LotConfig`."""

    num_aisles: standards.Counts = (1, 2)
    bays_per_row: standards.Counts = (9, 12)
    angle: Annotated[Range, Bounds(ge=30.0, le=75.0, unit="deg")] = (30.0, 75.0)
    two_way: bool = False
    extra_aisle: Annotated[Range, Bounds(ge=-3.0, unit="m")] = (0.0, 0.6)
    num_accessible: Natural = 0
    num_family: Natural = 0
    num_entrances: Annotated[IntRange, Bounds(ge=1, le=2)] = (1, 1)
    family: str = "angled"


register_layout("lot", LotConfig())
register_layout("angled", AngledConfig())


@struct.dataclass
class _Plan:
    """One lot as drawn, about the origin: () float32 [m] or int32 unless said."""

    angle: jax.Array  # between aisle and bays [rad]
    bay_width: jax.Array  # of standard bays
    bay_length: jax.Array  # of all bays
    aisle: jax.Array  # width of the aisles
    cross: jax.Array  # width of the cross aisles
    end: jax.Array  # width of the strips at the ends of the rows
    row: jax.Array  # length of a row between these strips, across the bays
    field: jax.Array  # length of the rows along x, strips and slant included
    half: jax.Array  # (2,) half width and half height inside the outer walls
    aisle_y: jax.Array  # (aisles,) centre lines
    aisle_mask: jax.Array  # (aisles,) bool
    entrance_y: jax.Array  # (2,) of the entrances at -x and +x
    entrance_mask: jax.Array  # (2,) bool


def _draw_plan(config: LotConfig, key: jax.Array) -> _Plan:
    chance = build.chances(key, 9)
    count = build.draw_int(chance[0], config.num_aisles)
    per_row = build.draw_int(chance[1], config.bays_per_row)
    degrees = build.draw(chance[2], config.angle)
    bay_width = build.draw(chance[3], config.bay_width)
    bay_length = build.draw(chance[4], config.bay_length)
    standard = jnp.interp(
        degrees, jnp.array(standards.AISLE_ANGLES), jnp.array(standards.AISLE_WIDTHS)
    )
    aisle = standard + build.draw(chance[5], config.extra_aisle)
    cross = build.draw(chance[6], config.cross_aisle)
    end = build.draw(chance[7], standards.ISLAND_WIDTH)
    entrances = build.draw_int(chance[8], config.num_entrances)

    angle = jnp.radians(degrees)
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    every = config.pillar_every
    gaps = (per_row - 1) // every * PILLAR_GAP if every else 0.0
    row = per_row * bay_width + gaps
    field = (row + 2 * end) / sin + bay_length * cos
    # Wide bays at an angle are deeper; they lie in the first row, at the bottom.
    wide = standards.ACCESSIBLE_WIDTH if config.num_accessible else 0.0
    wide = max(wide, standards.FAMILY_WIDTH if config.num_family else 0.0)
    below = standards.WALL_GAP + jnp.maximum(wide - bay_width, 0.0) * cos
    module = 2 * build.row_depth(bay_width, bay_length, angle) + aisle
    height = count * module + below + standards.WALL_GAP
    number = jnp.arange(config.num_aisles[1])
    aisle_y = (number + 0.5) * module + below - height / 2
    return _Plan(
        angle=angle,
        bay_width=bay_width,
        bay_length=bay_length,
        aisle=aisle,
        cross=cross,
        end=end,
        row=row,
        field=field,
        half=jnp.stack([field / 2 + cross, height / 2]),
        aisle_y=aisle_y,
        aisle_mask=number < count,
        entrance_y=jnp.stack([aisle_y[0], aisle_y[count - 1]]),
        entrance_mask=jnp.arange(2) < entrances,
    )


def _rows(config: LotConfig, plan: _Plan) -> list[build.Group]:
    """Bays, strips at the ends of the rows and pillars; (aisles, 2 sides, cells)."""
    num_aisles, most = config.num_aisles[1], config.bays_per_row[1]
    shape = (num_aisles, 2, most)
    kind, cell = np.full(shape, BayKind.STANDARD), np.arange(most)
    wide = config.num_accessible, config.num_accessible + config.num_family
    first = kind[0, 1]  # beside the outer wall
    first[: wide[1]], first[: wide[0]] = BayKind.FAMILY, BayKind.ACCESSIBLE
    accessible, family = kind == BayKind.ACCESSIBLE, kind == BayKind.FAMILY
    width = jnp.where(accessible, standards.ACCESSIBLE_WIDTH, plan.bay_width)
    width = jnp.where(family, standards.FAMILY_WIDTH, width)
    every = config.pillar_every
    pillar = (cell > 0) & (cell % every == 0) if every else np.zeros(most, bool)
    far = jnp.cumsum(width + np.where(pillar, np.float32(PILLAR_GAP), 0), axis=-1)
    mask = plan.aisle_mask[:, None, None] & (far <= plan.row + SLACK)
    last = jnp.max(jnp.where(mask, far, 0.0), axis=-1, keepdims=True)

    def place(near: jax.Array, width: jax.Array) -> jax.Array:
        """Poses of cells whose near lines lie so far behind the first bay's.

        They head out into the aisle.
        """
        sin, cos, yaw = jnp.sin(plan.angle), jnp.cos(plan.angle), plan.angle + jnp.pi
        # The corner at the far line touches the aisle's edge; from there to the centre
        # it is half a width back and half a length in.
        x = (near + plan.end) / sin + width / sin - width / 2 * sin
        x = x + plan.bay_length / 2 * cos - plan.field / 2
        y = width / 2 * cos + plan.bay_length / 2 * sin + plan.aisle / 2
        # Aisles alternate in direction if they have one; bays of the second side lie
        # to the right of it.
        way = (-1.0) ** (np.arange(num_aisles) * (not config.two_way))[:, None, None]
        side = np.array([[1.0], [-1.0]])
        yaw = jnp.arctan2(jnp.sin(yaw) * side, jnp.cos(yaw) * way)
        return build.stacked(x * way, y * side + plan.aisle_y[:, None, None], yaw)

    bay_pose = place(far - width, width)
    bay_size = build.stacked(plan.bay_length, width)
    groups = [build.bays(bay_pose, bay_size, kind, mask)]
    if every:
        gap, radius = jnp.full(shape, PILLAR_GAP), standards.PILLAR_RADIUS
        setback = plan.bay_length / 2 - standards.PILLAR_SETBACK - radius
        centre = move_forward(place(far - width - gap, gap), setback)[..., :2]
        groups.append(build.discs(centre, radius, DiscKind.PILLAR, mask & pillar))
    if config.row_ends != "open":
        # The strip fills what wide bays leave of their row, if it stays within the row.
        rest = jnp.minimum(plan.end + plan.row - last, plan.bay_width)
        strip = jnp.concatenate([jnp.broadcast_to(plan.end, rest.shape), rest], axis=-1)
        near = jnp.concatenate([jnp.broadcast_to(-plan.end, rest.shape), last], axis=-1)
        groups.append(_strips(config, plan, place(near, strip), strip))
    return groups


def _strips(
    config: LotConfig, plan: _Plan, pose: jax.Array, width: jax.Array
) -> build.Group:
    """Islands or pairs of bollards at the ends of the rows (aisles, 2 sides, 2)."""
    mask, radius = plan.aisle_mask[:, None, None], standards.BOLLARD_RADIUS
    if config.row_ends == "islands":
        size = build.stacked(plan.bay_length, width)
        return build.walls(pose, size, WallKind.ISLAND, mask)
    reach = plan.bay_length / 2 - BOLLARD_INSET
    both = [move_forward(pose, reach), move_forward(pose, -reach)]
    centre = jnp.stack(both, axis=-2)[..., :2]
    return build.discs(centre, radius, DiscKind.BOLLARD, mask[..., None])


def _lanes(config: LotConfig, plan: _Plan) -> list[build.Group]:
    """Lanes of aisles, cross aisles and entrances, and spawn regions in them."""
    pose, mask = build.stacked(0.0, plan.aisle_y, 0.0), plan.aisle_mask
    size = jnp.stack([plan.field, plan.aisle])
    if config.two_way:
        (pose, size), mask = build.two_lanes(pose, size), mask[:, None]
    else:
        backwards = (np.arange(len(mask)) % 2 == 1) != config.back_in
        pose = build.stacked(0.0, plan.aisle_y, np.where(backwards, np.pi, 0.0))
    groups = [*build.driven_lanes(config.car, pose, size, mask)]

    side = jnp.array([-1.0, 1.0])
    pose = build.stacked(side * (plan.field + plan.cross) / 2, 0.0, jnp.pi / 2)
    size = jnp.stack([2 * plan.half[1], plan.cross])
    groups += build.driven_lanes(config.car, *build.two_lanes(pose, size))

    x = side * (plan.half[0] + ENTRANCE_LENGTH / 2)
    pose = build.stacked(x, plan.entrance_y, jnp.array([0.0, jnp.pi]))
    size = jnp.array([ENTRANCE_LENGTH, ENTRANCE_WIDTH])
    pose, size = build.two_lanes(pose, size)
    groups.append(build.lanes(pose, size, mask=plan.entrance_mask[:, None]))
    # Only on the way in: no car starts at a closed gate and heads for it.
    inwards = pose[:, 0], size[0]
    return [*groups, build.spawns_in(config.car, *inwards, plan.entrance_mask)]


def _outer_walls(config: LotConfig, plan: _Plan) -> list[build.Group]:
    """Walls around the lot with openings at the entrances, and the gates in them."""
    thick, side = jnp.float32(standards.WALL_THICKNESS), jnp.array([-1.0, 1.0])
    kind = WallKind.WALL if config.boundary == "wall" else WallKind.KERB
    half_x, half_y = plan.half
    pose = build.stacked(0.0, side * (half_y + thick / 2), 0.0)
    ends = build.walls(pose, build.stacked(2 * (half_x + thick), thick), kind)
    # Two pieces on each side, which meet at the entrance's middle if there is none.
    opening = jnp.where(plan.entrance_mask, ENTRANCE_WIDTH, 0.0)
    low = (-half_y + plan.entrance_y - opening / 2) / 2
    high = (half_y + plan.entrance_y + opening / 2) / 2
    x = side * (half_x + thick / 2)
    pose = build.stacked(x, jnp.stack([low, high]), 0.0)
    ways = jnp.stack([plan.entrance_y, -plan.entrance_y])
    length = half_y + ways - opening / 2
    pieces = build.walls(pose, build.stacked(thick, length), kind)
    x = side * (half_x + (ENTRANCE_LENGTH + thick) / 2)
    aside = (ENTRANCE_WIDTH + thick) / 2
    pose = build.stacked(x, plan.entrance_y + side[:, None] * aside, 0.0)
    size = jnp.stack([ENTRANCE_LENGTH - thick, thick])
    flanks = build.walls(pose, size, kind, plan.entrance_mask)
    x = side * (half_x + ENTRANCE_LENGTH + thick / 2)
    pose = build.stacked(x, plan.entrance_y, 0.0)
    size = jnp.stack([thick, ENTRANCE_WIDTH + 2 * thick])
    gates = build.walls(pose, size, WallKind.GATE, plan.entrance_mask)
    return [ends, pieces, flanks, gates]

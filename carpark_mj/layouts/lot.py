"""A car park of several aisles with a row of bays on either side of each.

Rows of neighbouring aisles stand back to back. A cross aisle runs along both ends of
the aisles, entrances lead into the cross aisles through the outer walls, and a gate
closes each of them, so that no car leaves the lot.
"""

import dataclasses

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.config import register_layout
from carpark_mj.geometry import move_forward
from carpark_mj.layouts.build import (
    Group,
    assemble,
    bays,
    discs,
    lanes,
    spawns_in,
    two_lanes,
    walls,
)
from carpark_mj.layouts.lot_config import LotSettings
from carpark_mj.layouts.ranges import chances, draw, draw_int
from carpark_mj.layouts.rows import cell_poses, mirror, row_depth
from carpark_mj.layouts.standards import (
    ACCESSIBLE_WIDTH,
    AISLE_ANGLES,
    AISLE_WIDTHS,
    BOLLARD_RADIUS,
    FAMILY_WIDTH,
    PILLAR_CLEARANCE,
    PILLAR_RADIUS,
    PILLAR_SETBACK,
    WALL_GAP,
)
from carpark_mj.layouts.types import BayKind, DiscKind, Layout, WallKind

ENTRANCE_LENGTH = 7.0  # m, from the outer wall to the gate: longer than a car
ENTRANCE_WIDTH = 6.0  # m, two lanes
PILLAR_GAP = 2 * (PILLAR_RADIUS + PILLAR_CLEARANCE)  # m between the bays beside it
BOLLARD_INSET = 0.4  # m from the ends of a row's last strip
SLACK = 1e-3  # m, tolerance for bays that fit exactly


@struct.dataclass
class _Plan:
    """One lot as drawn: () float32 [m] or int32 unless said, the centre at the origin.

    Attributes:
        angle: between aisle and bays [rad].
        bay_width: of standard bays.
        bay_length: of all bays.
        aisle: width of the aisles.
        cross: width of the cross aisles.
        end: width of the strips at the ends of the rows.
        row: length of a row between these strips, across the bays.
        field: length of the rows along x, strips and slant included.
        half: (2,) half width and half height inside the outer walls.
        aisle_y: (aisles,) centre lines.
        aisle_mask: (aisles,) bool.
        entrance_y: (2,) of the entrances at -x and +x.
        entrance_mask: (2,) bool.
    """

    angle: jax.Array
    bay_width: jax.Array
    bay_length: jax.Array
    aisle: jax.Array
    cross: jax.Array
    end: jax.Array
    row: jax.Array
    field: jax.Array
    half: jax.Array
    aisle_y: jax.Array
    aisle_mask: jax.Array
    entrance_y: jax.Array
    entrance_mask: jax.Array


def _draw_plan(config: LotSettings, key: jax.Array) -> _Plan:
    chance = chances(key, 9)
    count = draw_int(chance[0], config.num_aisles)
    per_row = draw_int(chance[1], config.bays_per_row)
    degrees = draw(chance[2], config.angle)
    bay_width = draw(chance[3], config.bay_width)
    bay_length = draw(chance[4], config.bay_length)
    standard = jnp.interp(degrees, jnp.array(AISLE_ANGLES), jnp.array(AISLE_WIDTHS))
    aisle = standard + draw(chance[5], config.extra_aisle)
    cross = draw(chance[6], config.cross_aisle)
    end = draw(chance[7], config.end_width)
    entrances = draw_int(chance[8], config.num_entrances)

    angle = jnp.radians(degrees)
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    every = config.pillar_every
    gaps = (per_row - 1) // every * PILLAR_GAP if every else 0.0
    row = per_row * bay_width + gaps
    field = (row + 2 * end) / sin + bay_length * cos
    # Wide bays at an angle are deeper; they lie in the first row, at the bottom.
    wide = ACCESSIBLE_WIDTH if config.num_accessible else 0.0
    wide = max(wide, FAMILY_WIDTH if config.num_family else 0.0)
    below = WALL_GAP + jnp.maximum(wide - bay_width, 0.0) * cos
    module = 2 * row_depth(bay_width, bay_length, angle) + aisle
    height = count * module + below + WALL_GAP
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


@dataclasses.dataclass(frozen=True)
class LotConfig(LotSettings):
    """A car park, drawn from the ranges of `LotSettings`."""

    def generate(self, key: jax.Array) -> Layout:
        """Draws a car park whose aisles run along x; the first entrance is at -x."""
        plan = _draw_plan(self, key)
        return assemble(
            plan.half + jnp.array([ENTRANCE_LENGTH, 0.0]),
            *_rows(self, plan),
            *_outer_walls(self, plan),
            *_lanes(self, plan),
        )


register_layout("lot", LotConfig())


def _rows(config: LotSettings, plan: _Plan) -> list[Group]:
    """Bays, strips at the ends of the rows and pillars; (aisles, 2 sides, cells)."""
    num_aisles, most = config.num_aisles[1], config.bays_per_row[1]
    shape = (num_aisles, 2, most)
    first = jnp.zeros(shape, bool).at[0, 1].set(True)  # beside the outer wall
    cell = jnp.arange(most)
    accessible = first & (cell < config.num_accessible)
    family = first & (cell < config.num_accessible + config.num_family) & ~accessible
    kind = jnp.where(accessible, BayKind.ACCESSIBLE, BayKind.STANDARD)
    kind = jnp.where(family, BayKind.FAMILY, kind)
    width = jnp.where(accessible, ACCESSIBLE_WIDTH, plan.bay_width)
    width = jnp.where(family, FAMILY_WIDTH, width)
    every = config.pillar_every
    pillar = (cell > 0) & (cell % every == 0) if every else jnp.zeros(most, bool)
    far = jnp.cumsum(width + jnp.where(pillar, PILLAR_GAP, 0.0), axis=-1)
    mask = plan.aisle_mask[:, None, None] & (far <= plan.row + SLACK)
    last = jnp.max(jnp.where(mask, far, 0.0), axis=-1, keepdims=True)

    def place(near: jax.Array, width: jax.Array) -> jax.Array:
        """Poses of cells whose near lines lie so far behind the first bay's."""
        offset = (near + plan.end) / jnp.sin(plan.angle)
        pose = cell_poses(offset, width, plan.bay_length, plan.angle)
        pose = pose - jnp.stack([plan.field / 2, -plan.aisle / 2, jnp.zeros(())])
        # Aisles alternate in direction if they have one; bays of the second side lie
        # to the right of it.
        way = jnp.where(jnp.arange(num_aisles) % 2 == 0, 1.0, -1.0)
        way = jnp.ones_like(way) if config.two_way else way
        side = jnp.array([1.0, -1.0])
        pose = mirror(pose, way[:, None, None], side[:, None])
        return pose.at[..., 1].add(plan.aisle_y[:, None, None])

    bay_pose = place(far - width, width)
    bay_size = jnp.stack([jnp.broadcast_to(plan.bay_length, shape), width], axis=-1)
    groups = [bays(bay_pose, bay_size, kind, mask)]
    if every:
        gap = jnp.full(shape, PILLAR_GAP)
        setback = plan.bay_length / 2 - PILLAR_SETBACK - PILLAR_RADIUS
        centre = move_forward(place(far - width - gap, gap), setback)[..., :2]
        groups.append(discs(centre, PILLAR_RADIUS, DiscKind.PILLAR, mask & pillar))
    if config.row_ends != "open":
        # The strip fills what wide bays leave of their row, if it stays within the row.
        rest = jnp.minimum(plan.end + plan.row - last, plan.bay_width)
        strip = jnp.concatenate([jnp.broadcast_to(plan.end, rest.shape), rest], axis=-1)
        near = jnp.concatenate([jnp.broadcast_to(-plan.end, rest.shape), last], axis=-1)
        groups.append(_strips(config, plan, place(near, strip), strip))
    return groups


def _strips(
    config: LotSettings, plan: _Plan, pose: jax.Array, width: jax.Array
) -> Group:
    """Islands or pairs of bollards at the ends of the rows (aisles, 2 sides, 2)."""
    mask = plan.aisle_mask[:, None, None]
    if config.row_ends == "islands":
        length = jnp.broadcast_to(plan.bay_length, width.shape)
        return walls(pose, jnp.stack([length, width], axis=-1), WallKind.ISLAND, mask)
    reach = plan.bay_length / 2 - BOLLARD_INSET
    centre = jnp.stack(
        [move_forward(pose, reach), move_forward(pose, -reach)], axis=-2
    )[..., :2]
    return discs(centre, BOLLARD_RADIUS, DiscKind.BOLLARD, mask[..., None])


def _lanes(config: LotSettings, plan: _Plan) -> list[Group]:
    """Lanes of aisles, cross aisles and entrances, and spawn regions in them."""
    zero = jnp.zeros_like(plan.aisle_y)
    pose = jnp.stack([zero, plan.aisle_y, zero], axis=-1)
    size = jnp.stack([plan.field, plan.aisle])
    if config.two_way:
        pose, size = two_lanes(pose, jnp.broadcast_to(size, (*zero.shape, 2)))
        mask = jnp.stack([plan.aisle_mask] * 2, axis=-1)
    else:
        backwards = (jnp.arange(zero.shape[0]) % 2 == 1) != config.back_in
        pose = pose.at[:, 2].set(jnp.where(backwards, jnp.pi, 0.0))
        mask = plan.aisle_mask
    groups = [lanes(pose, size, mask=mask), spawns_in(config.car, pose, size, mask)]

    side = jnp.array([-1.0, 1.0])
    x = side * (plan.field + plan.cross) / 2
    pose = jnp.stack([x, jnp.zeros(2), jnp.full(2, jnp.pi / 2)], axis=-1)
    size = jnp.broadcast_to(jnp.stack([plan.cross, 2 * plan.half[1]])[::-1], (2, 2))
    pose, size = two_lanes(pose, size)
    groups += [lanes(pose, size), spawns_in(config.car, pose, size)]

    x = side * (plan.half[0] + ENTRANCE_LENGTH / 2)
    inwards = jnp.array([0.0, jnp.pi])
    pose = jnp.stack([x, plan.entrance_y, inwards], axis=-1)
    size = jnp.broadcast_to(jnp.array([ENTRANCE_LENGTH, ENTRANCE_WIDTH]), (2, 2))
    pose, size = two_lanes(pose, size)
    groups.append(lanes(pose, size, mask=plan.entrance_mask[:, None]))
    # Only on the way in: no car starts at a closed gate and heads for it.
    pose, size = pose[:, 0], size[:, 0]
    return [*groups, spawns_in(config.car, pose, size, plan.entrance_mask)]


def _outer_walls(config: LotSettings, plan: _Plan) -> list[Group]:
    """Walls around the lot with openings at the entrances, and the gates in them."""
    thick = jnp.float32(config.wall_thickness)
    kind = WallKind.WALL if config.boundary == "wall" else WallKind.KERB
    half_x, half_y = plan.half[0], plan.half[1]
    zero = jnp.zeros(())
    y = half_y + thick / 2
    long = jnp.stack([2 * (half_x + thick), thick])
    ends = walls(
        jnp.stack([jnp.stack([zero, s * y, zero]) for s in (-1, 1)]), long, kind
    )
    # Two pieces on each side, which meet at the entrance's middle if there is none.
    side = jnp.array([-1.0, 1.0])
    opening = jnp.where(plan.entrance_mask, ENTRANCE_WIDTH, 0.0)
    low = (-half_y + plan.entrance_y - opening / 2) / 2
    high = (half_y + plan.entrance_y + opening / 2) / 2
    x = jnp.broadcast_to(side * (half_x + thick / 2), (2, 2))
    pieces = jnp.stack([x, jnp.stack([low, high]), jnp.zeros((2, 2))], axis=-1)
    length = jnp.stack(
        [
            half_y + plan.entrance_y - opening / 2,
            half_y - plan.entrance_y - opening / 2,
        ]
    )
    pieces = walls(
        pieces, jnp.stack([jnp.broadcast_to(thick, (2, 2)), length], axis=-1), kind
    )
    x = side * (half_x + (ENTRANCE_LENGTH + thick) / 2)
    aside = (ENTRANCE_WIDTH + thick) / 2
    flanks = jnp.stack(
        [jnp.stack([x, plan.entrance_y + s * aside, 0 * x], axis=-1) for s in (-1, 1)]
    )
    size = jnp.stack([ENTRANCE_LENGTH - thick, thick])
    flanks = walls(flanks, size, kind, plan.entrance_mask)
    x = side * (half_x + ENTRANCE_LENGTH + thick / 2)
    gate = jnp.stack([x, plan.entrance_y, 0 * x], axis=-1)
    size = jnp.stack([thick, ENTRANCE_WIDTH + 2 * thick])
    return [ends, pieces, flanks, walls(gate, size, WallKind.GATE, plan.entrance_mask)]

"""The view from above, with shapely as the judge."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, lot, moved, polygons
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.cameras import BirdsEye, Seen, channels, see_from_above
from carpark_mj.layouts import layout_config, make_layout

CONFIG = BirdsEye(pixels=60, span=20.0)
POSE = (1.0, -2.0, 0.7)
LAYOUT = lot(
    [(6.0, 1.0, 0.3), (-4.0, -5.0, 2.0)],
    walls=[(0.0, 6.0, 0.2)],
    wall_size=[(8.0, 1.0)],
    discs=[(-3.0, 2.0, 0.8)],
)
PARKED = parked_at([(5.0, -5.0, 1.0)])
view = jax.jit(see_from_above, static_argnums=0)


def state():
    return state_of(LAYOUT, cars([POSE, (-5.0, -1.0, 1.0)]), 1, parked_cars=PARKED)


def test_every_pixel_shows_what_is_there():
    seen = np.asarray(view(CONFIG, state()))[0]
    side = 20.0 * (0.5 - (np.arange(60) + 0.5) / 60)
    ahead, left = np.meshgrid(side, side, indexing="ij")
    local = np.stack([ahead, left, 0.0 * ahead], axis=-1)
    points = shapely.points(np.asarray(moved(local, POSE))[..., :2])
    boxes = {
        Seen.BAY: (LAYOUT.bay_pose[:1], LAYOUT.bay_size[:1]),
        Seen.OWN_BAY: (LAYOUT.bay_pose[1:], LAYOUT.bay_size[1:]),
        Seen.WALL: (LAYOUT.wall_pose, LAYOUT.wall_size),
        Seen.CAR: ([(-5.0, -1.0, 1.0), (5.0, -5.0, 1.0)], [(4.0, 2.0)] * 2),
        Seen.OWN_CAR: ([POSE], [(4.0, 2.0)]),
    }
    shapes = {kind: shapely.union_all(polygons(*box)) for kind, box in boxes.items()}
    pillar = shapely.Point(-3.0, 2.0).buffer(0.8, quad_segs=64)
    shapes[Seen.WALL] = shapes[Seen.WALL].union(pillar)
    expected, edges = np.zeros((60, 60), int), np.zeros((60, 60), bool)
    for kind, shape in shapes.items():
        expected[shapely.contains(shape, points)] = kind
        # A line as wide as a pixel is painted about the sides, and within the far end.
        near = 0.34 if kind in (Seen.BAY, Seen.OWN_BAY) else 1e-3
        edges |= shapely.distance(shape.boundary, points) < near
    assert (seen == expected)[~edges].all()
    assert edges.mean() < 0.2
    assert {*np.unique(seen)} == {*boxes, Seen.FLOOR, Seen.LINE}
    one_hot = channels(seen, (Seen.CAR, Seen.OWN_CAR))
    np.testing.assert_array_equal(one_hot[..., 0], seen == Seen.CAR)


def test_lines_are_as_wide_as_painted():
    layout = lot([(0.0, 0.0, 0.2)], bay_size=(6.0, 3.0))
    config = BirdsEye(pixels=400, span=8.0)
    motion = cars([(0.0, 0.0, 0.0)], size=(0.1, 0.1))
    seen = np.asarray(view(config, state_of(layout, motion, 0)))[0]
    pixel = 8.0 / 400
    line = seen == Seen.LINE
    # Two sides of 6 m, half of each outside the bay, and the far end between them.
    area = 2 * 6.0 * 0.1 + 0.1 * (3.0 - 0.1)
    assert line.sum() * pixel**2 == pytest.approx(area, rel=0.02)
    assert line[-100:].sum() > 2 * line[:100].sum()  # the far end is behind


@pytest.mark.parametrize("layout", ["lot", "angled", "dragon_lake"])
def test_a_small_view_is_the_middle_of_a_large_one(layout):
    family = layout_config(layout)

    @jax.jit
    @jax.vmap
    def views(key):
        there = make_layout(family, key)
        askew = there.bay_pose[:2] + jnp.array([0.7, -0.4, 0.3])
        parked = parked_in(there, np.arange(2, 14))
        state = state_of(there, cars(askew), np.arange(2), parked_cars=parked)
        sizes = (24, 8.0), (240, 80.0)
        return [see_from_above(BirdsEye(*size), state) for size in sizes]

    small, large = map(np.asarray, views(jax.random.split(jax.random.key(0), 8)))
    # Where a pixel's middle lies on an edge, rounding decides.
    same = small == large[..., 108:132, 108:132]
    assert same.mean() > 0.999
    assert {Seen.OWN_CAR, Seen.LINE, Seen.BAY} < {*np.unique(small)}


def test_absent_cars_are_not_there():
    absent = state().replace(parked_cars=parked_at([(5.0, -5.0, 1.0)], present=False))
    alone = state().replace(parked_cars=parked_at([(500.0, 0.0, 0.0)]))
    np.testing.assert_array_equal(view(CONFIG, absent), view(CONFIG, alone))
    assert jnp.asarray(view(CONFIG, absent)).dtype == jnp.uint8

"""Cameras by hand and against MuJoCo's own pictures; shapely judges the bird's eye."""

import functools
import itertools
import math

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import shapely
from helpers.scenes import cars, lot, moved, polygons
from helpers.states import parked_at, parked_in, state_of

from carpark_mj.cameras import (
    RIGS,
    BirdsEye,
    Camera,
    FaultConfig,
    Heights,
    Lens,
    Rig,
    Seen,
    colours,
    draw_faults,
    noisy_depth,
    see,
    see_from_above,
)
from carpark_mj.cameras.rig import BODY, CABIN
from carpark_mj.geometry.obstacles import Boxes, Discs, Movers, ObstacleKind
from carpark_mj.layouts import WallKind, layout_config, make_layout
from carpark_mj.layouts.types import WALL_HEIGHTS, DiscKind

# A car of 4 m x 2 m is 1.5 m tall.
HEIGHTS = Heights((0.375,), (0.375,))
NOSE, EYE = 2.4, 0.6  # m, where a camera at (1.2, 0, 0.4) is
AHEAD = Rig((Camera((1.2, 0.0, 0.4)),), width=9, height=9)
see_jit = jax.jit(see, static_argnums=(0, 2))


def look(rig, layout, motion, **changes):
    pictures = see_jit(rig, state_of(layout, motion, 0, **changes), HEIGHTS)
    return jax.tree.map(np.asarray, pictures)


def wall(distance, kind=WallKind.WALL, width=40.0):
    layout = lot(
        [(-20.0, 0.0, 0.0)],
        walls=[(NOSE + distance + 0.5, 0.0, 0.0)],
        wall_size=[(1.0, width)],
    )
    return layout.replace(wall_kind=jnp.full(1, int(kind), jnp.int32))


def test_depth_is_that_of_the_wall_and_the_ground_along_each_ray():
    depth, seen = (
        getattr(look(AHEAD, wall(3.0), cars([(0.0, 0.0, 0.0)])), name)[0, 0]
        for name in ("depth", "seen")
    )
    # The middle ray is level; those of the middle row go aside at tan = k * 2 / 9.
    slope = 2 / 9 * np.arange(-4, 5)
    np.testing.assert_allclose(depth[4], 3.0 * np.hypot(1.0, slope), rtol=1e-4)
    assert (seen[4] == Seen.WALL).all()
    # 0.9 m tall, it ends 0.3 m above the camera.
    assert (seen[:4] == Seen.SKY).all()
    assert (depth[:4] == AHEAD.reach).all()
    # Below, the ground is EYE / sin(elevation) away where that is before the wall.
    down = slope[5:]
    before = EYE / down < 3.0
    expected = EYE / np.sin(np.arctan(down))
    np.testing.assert_allclose(depth[5:, 4][before], expected[before], rtol=1e-4)
    assert (seen[5:, 4][before] == Seen.FLOOR).all()
    assert (seen[5:, 4][~before] == Seen.WALL).all()


@pytest.mark.parametrize(
    ("kind", "shown"),
    [
        (WallKind.WALL, Seen.WALL),
        (WallKind.GATE, Seen.WALL),
        (WallKind.KERB, Seen.KERB),
        (WallKind.ISLAND, Seen.KERB),
    ],
)
def test_low_walls_are_kerbs_that_hide_little(kind, shown):
    seen = look(AHEAD, wall(1.5, kind), cars([(0.0, 0.0, 0.0)])).seen[0, 0]
    assert shown in seen
    assert (seen[4] == Seen.WALL).all() == (shown == Seen.WALL)


def test_everything_has_its_own_look():
    """What stands on a ray, and the ground with bays, lines and the sky."""
    camera = Camera((1.2, 0.0, 2.0), pitch=math.radians(30.0))
    rig = Rig((camera,), width=161, height=121)
    layout = lot(
        [(9.0, 0.0, math.pi), (9.0, 3.0, math.pi), (30.0, 30.0, 0.0)],
        walls=[(20.0, 0.0, 0.0), (7.0, -3.0, 0.0)],
        wall_size=[(1.0, 30.0), (0.5, 2.0)],
    )
    kinds = jnp.array([WallKind.WALL, WallKind.KERB], jnp.int32)
    people = Discs(jnp.array([[6.0, 0.0]]), jnp.array([0.3]), kind=ObstacleKind.PERSON)
    there = Movers((None,), ((people,),))
    seen = look(
        rig,
        layout.replace(wall_kind=kinds),
        cars([(0.0, 0.0, 0.0)]),
        parked_cars=parked_at([(9.0, 3.0, math.pi)]),
        movers=there,
    ).seen[0, 0]
    assert {*np.unique(seen)} == {*Seen} - {Seen.OWN_CAR}
    assert seen[60, 80] == Seen.PERSON  # its axis meets the ground at 5.4 m
    cart = Movers((None,), ((Boxes(jnp.array([[5.4, 0.0, 0.3]]), jnp.ones((1, 2))),),))
    seen = look(rig, layout, cars([(0.0, 0.0, 0.0)]), movers=cart).seen[0, 0]
    assert seen[60, 80] == Seen.CAR


def test_the_body_hides_what_is_behind_it_but_not_the_view_out():
    at = cars([(0.0, 0.0, 0.0)])
    seen = look(RIGS["surround"], wall(3.0), at).seen[0]
    own = (seen == Seen.OWN_CAR).mean(axis=(1, 2))
    assert ((own > 0.05) & (own < 0.6)).all()
    # Mirrors see the car's side in the lower half of the picture, and nothing above.
    assert (seen[2:, -1] == Seen.OWN_CAR).mean() > 0.9
    assert not (seen[2:, : seen.shape[1] // 4] == Seen.OWN_CAR).any()
    seen = look(RIGS["windscreen"], wall(3.0), at).seen[0, 0]
    assert (seen[-1] == Seen.OWN_CAR).any()  # the bonnet
    assert not (seen[: seen.shape[0] // 2] == Seen.OWN_CAR).any()


@pytest.mark.parametrize("projection", ["pinhole", "fisheye"])
@pytest.mark.parametrize("distortion", [(), (-0.02, 0.001)])
def test_rays_fall_where_the_lens_puts_them(projection, distortion):
    lens = Lens(projection, math.radians(100.0), distortion)
    rays = lens.directions(32, 24)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1.0, atol=1e-9)
    angle = np.arccos(rays[..., 0])
    aside = np.stack([-rays[..., 1], -rays[..., 2]], axis=-1)
    aside = aside / np.linalg.norm(aside, axis=-1, keepdims=True)
    radius = lens.radius(angle) / lens.radius(np.array(lens.fov / 2)) * 16
    row, column = np.mgrid[:24, :32]
    np.testing.assert_allclose(radius * aside[..., 0], column - 15.5, atol=1e-5)
    np.testing.assert_allclose(radius * aside[..., 1], row - 11.5, atol=1e-5)


@functools.cache
def faulty(**settings):
    config = FaultConfig(**settings)
    rig = RIGS["surround"]
    faults = draw_faults(config, rig, 1, jax.random.key(0))
    state = state_of(wall(3.0), cars([(0.0, 0.0, 0.0)]), 0)
    return faults, see_jit(rig, state, HEIGHTS, faults)


def test_faults_of_no_size_change_nothing():
    pictures = look(RIGS["surround"], wall(3.0), cars([(0.0, 0.0, 0.0)]))
    _, same = faulty()
    assert (same.seen == pictures.seen).mean() > 0.999
    np.testing.assert_allclose(same.depth, pictures.depth, rtol=1e-4)
    rgb = colours(pictures)
    assert (pictures.shade == pictures.shade.max()).all()
    assert rgb.shape == (1, 4, 48, 64, 3)
    assert 0.0 <= float(rgb.min()) <= float(rgb.max()) <= 1.0


def test_faults_turn_shift_hide_and_darken():
    _, exact = faulty()
    faults, spoilt = faulty(
        turn=0.05, shift=0.02, spots=3, spot_size=0.2, exposure=(0.4, 0.6)
    )
    turn = np.asarray(faults.turn)
    identity = np.broadcast_to(np.eye(3), turn.shape)
    np.testing.assert_allclose(turn.swapaxes(-1, -2) @ turn, identity, atol=1e-5)
    hidden = (np.asarray(spoilt.depth) == 0.0).mean()
    assert 0.001 < hidden < 0.3
    assert (np.asarray(spoilt.seen) != np.asarray(exact.seen)).mean() > 0.02
    assert colours(spoilt, faults).mean() < 0.8 * colours(exact).mean()
    config = FaultConfig(depth_noise=0.02)
    noisy = noisy_depth(config, exact.depth, 50.0, jax.random.key(1))
    near = np.asarray(exact.depth) < 20.0
    spread = np.std((np.asarray(noisy) / np.asarray(exact.depth))[near])
    assert spread == pytest.approx(0.02, rel=0.1)


TWO = Camera((1.2, 0.0, 0.4)), Camera((0.1, -1.2, 0.8), yaw=-1.5, pitch=0.2)
BOX, CYLINDER = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER


def test_depth_and_classes_are_those_of_mujocos_rays():
    """Among turned cars, walls and a bollard, each as high as it is."""
    rig, heights = Rig(TWO, width=64, height=48), Heights((0.375,), (0.5,))
    walls, post = [(9.0, 5.0, 0.5), (2.0, -6.0, -1.1)], (2.0, -3.5, 0.4)
    sizes, kinds = [(5.0, 0.4), (6.0, 0.3)], [WallKind.WALL, WallKind.KERB]
    layout = lot([(-40.0, 0.0, 0.0)], walls, wall_size=sizes, discs=[post])
    agents, parked = [(0.0, 0.0, 0.6), (5.0, 6.0, -2.0)], (8.0, -4.0, 1.2)
    state = state_of(
        layout.replace(
            wall_kind=jnp.array(kinds), disc_kind=jnp.array([DiscKind.BOLLARD])
        ),
        cars(agents),
        0,
        parked_cars=parked_at([parked], (5.0, 1.8)),
    )
    spec, looks = mujoco.MjSpec(), [Seen.FLOOR]
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])

    def add(look, pose, half, low, high, shape=BOX):
        x, y, yaw = pose
        size, turn = [*half, (high - low) / 2], [math.cos(yaw / 2), 0, 0]
        at = {"pos": [x, y, (low + high) / 2], "quat": [*turn, math.sin(yaw / 2)]}
        spec.worldbody.add_geom(type=shape, size=[*size, 0][:3], **at)
        looks.append(look)

    for pose, size, kind in zip(walls, sizes, kinds, strict=True):
        look = Seen.KERB if kind == WallKind.KERB else Seen.WALL
        add(look, pose, np.divide(size, 2), 0.0, WALL_HEIGHTS[kind])
    add(Seen.WALL, (*post[:2], 0.0), (0.4,), 0.0, 0.9, CYLINDER)
    own = [(pose, 4.0, 2.0, 1.5) for pose in agents]
    for pose, length, width, high in (*own, (parked, 5.0, 1.8, 2.5)):
        for rear, front, wide, bottom, top in (BODY, CABIN):
            centre = moved([length / 4 * (rear + front), 0.0, 0.0], pose)
            half = length / 4 * (front - rear), width / 2 * wide
            add(Seen.CAR, centre, half, max(bottom * high, 0.16), top * high)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pictures = jax.device_get(see_jit(rig, state, heights))
    for (agent, pose), (k, camera) in itertools.product(
        enumerate(agents), enumerate(TWO)
    ):
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        eye = np.multiply(camera.position, (2.0, 1.0, 1.5)) @ turn + [x, y, 0.0]
        rays = (rig.directions[k].reshape(-1, 3) @ turn).ravel()
        geom, depth = np.zeros(64 * 48, np.int32), np.zeros(64 * 48)
        found = geom, depth, None, len(geom), 1e3
        mujoco.mj_multiRay(model, data, eye, rays, None, True, -1, *found)
        depth = np.where(geom < 0, rig.reach, np.minimum(depth, rig.reach))
        seen = np.where(geom < 0, Seen.SKY, np.array(looks)[geom])
        off = np.abs(pictures.depth[agent, k].ravel() - depth)
        assert (off < 0.01).mean() > 0.998
        assert (pictures.seen[agent, k].ravel() == seen).mean() > 0.998


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


def bird_state():
    return state_of(LAYOUT, cars([POSE, (-5.0, -1.0, 1.0)]), 1, parked_cars=PARKED)


def test_every_pixel_shows_what_is_there():
    seen = np.asarray(view(CONFIG, bird_state()))[0]
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
        bird_state = state_of(there, cars(askew), np.arange(2), parked_cars=parked)
        sizes = (24, 8.0), (240, 80.0)
        return [see_from_above(BirdsEye(*size), bird_state) for size in sizes]

    small, large = map(np.asarray, views(jax.random.split(jax.random.key(0), 8)))
    # Where a pixel's middle lies on an edge, rounding decides.
    same = small == large[..., 108:132, 108:132]
    assert same.mean() > 0.999
    assert {Seen.OWN_CAR, Seen.LINE, Seen.BAY} < {*np.unique(small)}


def test_absent_cars_are_not_there():
    absent = bird_state().replace(
        parked_cars=parked_at([(5.0, -5.0, 1.0)], present=False)
    )
    alone = bird_state().replace(parked_cars=parked_at([(500.0, 0.0, 0.0)]))
    np.testing.assert_array_equal(view(CONFIG, absent), view(CONFIG, alone))
    assert jnp.asarray(view(CONFIG, absent)).dtype == jnp.uint8

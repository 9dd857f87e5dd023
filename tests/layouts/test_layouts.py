"""Lots by hand, their faults and padding; scaled lots, and lots that are drawn once."""

import dataclasses
import functools
import math
import os
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.compilation import cache_folder
from carpark_mj.geometry import box_corners
from carpark_mj.layouts import (
    AngledConfig,
    ClutterConfig,
    Maxima,
    MixtureConfig,
    ScaledConfig,
    SquareConfig,
    StoredConfig,
    StreetConfig,
    make_layout,
    member_shares,
    pad_layout,
)
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.layouts.stored import stored_lots
from carpark_mj.layouts.types import mirror
from carpark_mj.training.ppo.learn import training_env
from carpark_mj.training.ppo.parts import PRESETS

WU = 0.5625  # m per world unit of Tanner's scene
EXACT = 1e-5  # m; float32 at 25 m resolves 2e-6 m


def test_tanner_bays_lie_where_his_scene_has_them():
    layout = make_layout("square")
    pose = np.asarray(layout.bay_pose)
    along = [-24, -18, -12, -6, 0, 6, 12, 18, 24]
    # Headings of his table, clockwise from +y, turned into ours: 90 deg - heading.
    rows = [[(s, -32, 0) for s in along], [(32, s, 270) for s in along]]
    rows += [[(s, 32, 180) for s in along], [(-32, s, 90) for s in along]]
    x, y, heading = np.reshape(rows, (36, 3)).T
    np.testing.assert_allclose(pose[:, :2], np.stack([x, y], -1) * WU, atol=EXACT)
    turn = np.exp(1j * pose[:, 2]) - np.exp(1j * np.radians(90 - heading))
    assert np.abs(turn).max() < EXACT


def test_tanner_s_walls_and_spawn_region_are_his():
    layout = make_layout("square")
    pose, size = np.asarray(layout.wall_pose), np.asarray(layout.wall_size)
    blocks = size[:, 0] == size[:, 1]
    corners = sorted(map(tuple, np.round(pose[blocks, :2] / WU, 4)))
    assert corners == [(-32, -32), (-32, 32), (32, -32), (32, 32)]
    np.testing.assert_allclose(size[blocks], 9 * WU, atol=EXACT)
    distance = np.linalg.norm(pose[~blocks, :2], axis=1)
    inner_face = distance - size[~blocks, 1] / 2
    np.testing.assert_allclose(inner_face, 37.5 * WU, atol=EXACT)
    np.testing.assert_allclose(layout.spawn_size, [[42 * WU, 42 * WU]], atol=EXACT)
    np.testing.assert_array_equal(layout.spawn_pose, [[0, 0, 0]])


@pytest.mark.parametrize(
    ("name", "bay"), [("square_compact", (5.0, 2.5)), ("square", (10 * WU, 6 * WU))]
)
def test_a_square_lot_has_36_bays_that_open_into_it_and_8_walls(name, bay):
    layout = make_layout(name)
    assert int(layout.bay_mask.sum()) == 36
    size = np.asarray(layout.wall_size)[np.asarray(layout.wall_mask)]
    assert (size[:, 0] == size[:, 1]).sum() == 4  # blocks
    assert (size[:, 0] > 4 * size[:, 1]).sum() == 4  # slabs
    assert int(layout.spawn_mask.sum()) == 1
    np.testing.assert_allclose(layout.bay_size, [bay] * 36, atol=EXACT)
    # The middle of the bay's front edge lies on the edge of the open square, and rows
    # start where the square of nine bay widths ends.
    pose = np.asarray(layout.bay_pose)
    ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=1)
    mouth, half = pose[:, :2] + ahead * bay[0] / 2, 9 * bay[1] / 2
    np.testing.assert_allclose(np.abs(mouth).max(axis=1), half, atol=EXACT)
    far = np.abs(pose[:, :2]).max(axis=1)
    np.testing.assert_allclose(far, half + bay[0] / 2, atol=EXACT)
    for leaf in jax.tree.leaves(layout):
        assert leaf.dtype in (jnp.float32, jnp.int32, jnp.bool_)
        assert not leaf.weak_type


def furnished(layout, disc=None, lane=None, lane_width=2.0):
    """The layout with a disc (x, y, radius) or a lane along x so far below."""
    x, y, radius = disc or (0.0, 0.0, 0.0)
    return pad_layout(layout, Maxima(36, 8, 1, 1, 1)).replace(
        disc_centre=jnp.array([[x, y]]),
        disc_radius=jnp.array([radius]),
        disc_mask=jnp.array([disc is not None]),
        lane_pose=jnp.array([[0.0, -(lane or 0.0), 0.0]]),
        lane_size=jnp.array([[10.0, lane_width]]),
        lane_mask=jnp.array([lane is not None]),
    )


def test_lots_of_other_sizes_and_things_out_of_the_way_are_sound():
    config = SquareConfig(bays_per_side=5, bay_width=2.7, bay_length=5.2)
    layout = config.generate(jax.random.key(0))
    assert layout.num_bays == 20
    assert describe_faults(layout) == []
    layout = make_layout("square")
    assert describe_faults(furnished(layout, (15.5, 15.5, 0.2), lane=10.0)) == []
    layout = make_layout("square_compact")
    assert describe_faults(layout, (4.5, 1.8)) == []  # a larger car needs more room
    problems = describe_faults(layout, (5.1, 1.8))
    assert problems[0].startswith("bays are smaller than the car: [0, 1, 2]")


def put(field, row, value):
    """Changes rows of a field, `value` may be a function of the layout."""

    def change(lot):
        new = value(lot) if callable(value) else value
        return lot.replace(**{field: getattr(lot, field).at[row].set(new)})

    return change


DISC = (0.0, -14.0, 0.3)
FAULTS = [
    ("bays overlap", put("bay_pose", (1, 0), lambda lot: lot.bay_pose[1, 0] - 1.0)),
    ("bays overlap", put("bay_pose", 1, lambda lot: lot.bay_pose[0])),
    ("bay_size must be positive", put("bay_size", (3, 1), -1.0)),
    ("wall_size holds a non-finite", put("wall_size", (0, 0), math.inf)),
    ("extent", put("extent", 0, math.nan)),
    (r"bays lie outside the extent: \[0\]", put("bay_pose", (0, 1), -50.0)),
    ("bays meet walls", put("wall_pose", 0, lambda lot: lot.bay_pose[5])),
    ("spawn regions meet walls", put("spawn_size", 0, 32.0)),
    ("no bay", put("bay_mask", ..., False)),
    ("no spawn region", put("spawn_mask", ..., False)),
    ("bay_mask must be bool", lambda lot: lot.replace(bay_mask=jnp.ones(36))),
    ("wall_pose must be", lambda lot: lot.replace(wall_pose=lot.wall_pose[:7])),
    ("bay_kind must be int32", lambda lot: lot.replace(bay_kind=jnp.zeros(36))),
    ("bays meet discs: ", lambda lot: furnished(lot, (0.0, -17.0, 0.3))),
    ("cars spawning in spawn regions meet discs", lambda lot: furnished(lot, DISC)),
    ("lanes meet discs", lambda lot: furnished(lot, DISC, lane=14.0)),
    ("lanes meet bays", lambda lot: furnished(lot, lane=14.0, lane_width=4.0)),
    ("lanes meet walls", lambda lot: furnished(lot, lane=21.5)),
    ("cars spawning in spawn regions meet bays", put("spawn_size", 0, 27.0)),
    (r"bays are smaller than the car: \[7\]", put("bay_size", 7, np.array([5.0, 1.7]))),
]


@pytest.mark.parametrize(("word", "broken"), FAULTS)
def test_describe_faults_names_each_kind_of_fault(word, broken):
    problems = describe_faults(broken(make_layout("square")))
    assert any(re.search(word, problem) for problem in problems), problems


@pytest.mark.parametrize("name", ["square_compact", "square"])
def test_padding_keeps_a_layout_well_formed_and_its_rows(name):
    layout = make_layout(name)
    assert describe_faults(layout) == []
    padded = pad_layout(layout, Maxima(40, 11, 2, 4, 3))
    assert describe_faults(padded) == []
    kinds = ("bay", "wall", "disc", "lane", "spawn")
    counts = [len(getattr(padded, f"{kind}_mask")) for kind in kinds]
    assert counts == [40, 11, 2, 4, 3]
    for kind in ("bay", "wall", "spawn"):
        mask = np.asarray(getattr(padded, f"{kind}_mask"))
        for part in ("pose", "size"):
            rows = np.asarray(getattr(padded, f"{kind}_{part}"))
            real = np.asarray(getattr(layout, f"{kind}_{part}"))
            np.testing.assert_array_equal(rows[mask], real)
            np.testing.assert_array_equal(rows[~mask], 0.0)


# Lots at other scales, and lots that are drawn once and picked from

STREET = StreetConfig(bays_per_side=(3, 4))
LOTS = MixtureConfig((ScaledConfig(STREET, (1.2, 1.5)), SquareConfig()), (3.0, 1.0))


def draw(config, count, *member):
    """Lots (count, ...) of a config, or of its member."""
    if member:
        generate = functools.partial(config.generate_member, *member)
    else:
        generate = config.generate
    keys = jax.random.split(jax.random.key(1), count)
    return jax.device_get(jax.jit(jax.vmap(generate))(keys))


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    stored_lots.cache_clear()
    yield cache_folder().parent
    stored_lots.cache_clear()


def test_a_scaled_lot_is_longer_with_the_same_headings():
    scaled = draw(ScaledConfig(STREET, (0.8, 1.6)), 32)
    width = scaled.bay_size[..., 1].max(axis=1, keepdims=True)
    assert width.min() < 0.95 * 2.6
    assert width.max() > 1.4 * 2.6
    large, one = (draw(ScaledConfig(STREET, (x, x)), 4) for x in (1.5, 1.0))
    for name, before in vars(one).items():
        after, part = getattr(large, name), name.split("_")[-1]
        if part == "pose":
            np.testing.assert_array_equal(after[..., 2], before[..., 2])
            after, before = after[..., :2], before[..., :2]
        if part in ("pose", "centre", "size", "radius", "extent"):
            np.testing.assert_allclose(after, 1.5 * before, rtol=1e-5)
        elif part in ("mask", "kind"):
            np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize("config", [AngledConfig(), ClutterConfig()])
def test_a_mirrored_lot_has_its_corners_on_the_other_side(config):
    lots = draw(config, 16)
    image = jax.device_get(mirror(lots))
    for name in ("bay", "wall", "lane", "spawn"):
        pose, size = getattr(lots, f"{name}_pose"), getattr(lots, f"{name}_size")
        flipped = box_corners(pose, size) * np.array([1.0, -1.0])
        corners = box_corners(getattr(image, f"{name}_pose"), size)
        gap = np.linalg.norm(flipped[..., None, :] - corners[..., None, :, :], axis=-1)
        assert gap.min(axis=-1).max(initial=0.0) < 1e-3
        ahead = np.cos(pose[..., 2]) - np.cos(getattr(image, f"{name}_pose")[..., 2])
        assert np.abs(ahead).max(initial=0.0) < 1e-6  # they face the same way along x
    np.testing.assert_array_equal(image.disc_centre, lots.disc_centre * [1.0, -1.0])
    jax.tree.map(np.testing.assert_array_equal, jax.device_get(mirror(image)), lots)


def test_picked_lots_are_those_that_are_kept(own_cache):
    config = StoredConfig(LOTS, 40)
    assert config.counts == (30, 10)
    kept = stored_lots(config)
    assert len(kept.extent) == 40
    shares = member_shares(config)
    assert list(shares.values()) == [0.75, 0.25]

    def nearest(lot, rows):
        """How far a lot, scaled back, is from the nearest of the kept ones [m]."""
        factor = lot.extent[0] / kept.extent[rows, 0]
        own = np.abs(lot.bay_pose[:, :2]) / factor[:, None, None]
        gap = np.abs(own - np.abs(kept.bay_pose[rows, :, :2])).max(axis=(1, 2))
        return gap.min(), factor[gap.argmin()]

    mirrored = []
    for member, rows, scale in ((0, slice(30), (1.2, 1.5)), (1, slice(30, 40), (1, 1))):
        lots = draw(config, 24, member)
        for k in range(24):
            lot = jax.tree.map(lambda x, k=k: x[k], lots)
            gap, factor = nearest(lot, rows)
            assert gap < 1e-3
            assert scale[0] - 1e-4 <= factor <= scale[1] + 1e-4
            mirrored.append(np.sign(lot.bay_pose[0, 1]))
    assert len(set(mirrored)) == 2


def test_lots_are_kept_in_a_file_and_drawn_again_if_it_is_damaged(own_cache):
    config = StoredConfig(LOTS, 8)
    drawn = stored_lots(config)
    (file,) = own_cache.glob("lots-*.npz")
    written = os.stat(file).st_mtime_ns
    stored_lots.cache_clear()
    jax.tree.map(np.testing.assert_array_equal, stored_lots(config), drawn)
    assert os.stat(file).st_mtime_ns == written
    file.write_bytes(file.read_bytes()[:100])
    stored_lots.cache_clear()
    jax.tree.map(np.testing.assert_array_equal, stored_lots(config), drawn)
    assert len(file.read_bytes()) > 100


def test_a_fixed_lot_is_not_stored():
    """It would be mirrored."""
    preset = PRESETS["valet"]
    assert isinstance(training_env(preset).layout, StoredConfig)
    env = dataclasses.replace(preset.env, layout="square")
    assert training_env(dataclasses.replace(preset, env=env)).layout == "square"

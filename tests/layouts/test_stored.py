"""Lots at other scales, and lots that are drawn once and picked from."""

import dataclasses
import functools
import os

import jax
import numpy as np
import pytest

from carpark_mj.compilation import cache_folder
from carpark_mj.geometry import box_corners
from carpark_mj.layouts import (
    AngledConfig,
    ClutterConfig,
    MixtureConfig,
    ScaledConfig,
    SquareConfig,
    StoredConfig,
    StreetConfig,
    member_shares,
)
from carpark_mj.layouts.stored import stored_lots
from carpark_mj.layouts.types import mirror
from carpark_mj.training.ppo.learn import training_env
from carpark_mj.training.ppo.parts import PRESETS

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

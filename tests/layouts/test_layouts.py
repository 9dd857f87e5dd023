import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from carpark_mj.layouts import Maxima, SquareConfig, make_layout, pad_layout
from carpark_mj.layouts.checks import describe_faults

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
def test_padding_keeps_a_layout_well_formed_and_its_real_rows_as_they_are(name):
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

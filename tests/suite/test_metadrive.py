"""MetaDrive's parking lot: its numbers, and where cars can drive in it."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from shapely import LineString, Point, Polygon

from carpark_mj.geometry import box_corners, boxes_overlap
from carpark_mj.layouts import BayKind, make_layout
from carpark_mj.layouts.checks import describe_faults
from carpark_mj.suite.metadrive import MetaDriveConfig

CAR = (4.515, 1.852)  # MetaDrive's default car [m]
# The lot's middle in coordinates whose x begins with the road: half of 20 + 2 * 4 +
# 3 * 3.5 + 4 + 10 + 1.5 * 3.5.
MIDDLE = np.array([57.75 / 2, 0.0])


@pytest.fixture(scope="module")
def layout():
    return make_layout("metadrive")


def test_spaces_exits_and_starts_lie_where_metadrive_has_them(layout):
    assert not describe_faults(layout, CAR)
    kind = np.asarray(layout.bay_kind)
    assert kind.tolist() == [BayKind.STANDARD] * 8 + [BayKind.EXIT] * 3
    bay = np.asarray(layout.bay_pose)
    at = bay[:, :2] + MIDDLE
    # Spaces 3.5 m x 8 m, side by side, 4 m from the middles of the lanes at 1.75 m.
    columns = (24.0, 27.5, 31.0, 34.5)
    expected = [(x, y) for y in (-9.75, 9.75) for x in columns]
    np.testing.assert_allclose(at[:8], expected, atol=1e-5)
    assert np.unique(layout.bay_size[:8], axis=0).tolist() == [[8.0, 3.5]]
    np.testing.assert_allclose(np.sin(bay[:8, 2]), [1.0] * 4 + [-1.0] * 4)
    # The lane that leaves by the road ends where the road's second half begins; those
    # of the arms end 10 m beyond right turns of 10 m radius from 42.5 m on.
    ends = at[8:] - 5.0 * np.stack([np.cos(bay[8:, 2]), np.sin(bay[8:, 2])], 1)
    expected = [(10.0, 1.75), (52.5, -21.75), (56.0, 21.75)]
    np.testing.assert_allclose(ends, expected, atol=1e-5)
    # Three starts 4 m from the lanes' beginnings, eight in the middles of the spaces.
    start = np.asarray(layout.spawn_pose)
    expected = [(14.0, -1.75), (56.0, -17.75), (52.5, 17.75)]
    np.testing.assert_allclose(start[:3, :2] + MIDDLE, expected, atol=1e-5)
    np.testing.assert_allclose(start[3:], bay[:8], atol=1e-5)


def test_kerbs_close_the_lot_and_stand_on_no_way(layout):
    pose, size = layout.wall_pose, layout.wall_size
    kerbs = [Polygon(c) for c in np.asarray(box_corners(pose, size))]
    # A way around the lot crosses a kerb wherever it leaves the ground.
    inside = Point(0.0, 0.0)
    for angle in np.linspace(0.0, 2 * math.pi, 200):
        far = Point(80 * math.cos(angle), 80 * math.sin(angle))
        assert any(k.intersects(LineString([inside, far])) for k in kerbs)
    # Bends of 4 m from lanes into spaces and of 10 m at the junction are free.
    ways = [_arc((20.0, -5.75), 4.0, 0, 90), _arc((38.5, -5.75), 4.0, 90, 180)]
    ways += [_arc((20.0, 5.75), 4.0, -90, 0), _arc((42.5, -11.75), 10.0, 0, 90)]
    for way in ways:
        car = jnp.array(np.concatenate([way[:, :2] - MIDDLE, way[:, 2:]], 1))
        hit = boxes_overlap(car[:, None], jnp.array(CAR), pose, size)
        assert not hit.any()


def _arc(centre, radius, begin, end):
    angle = np.radians(np.linspace(begin, end, 30))
    x, y = centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)
    return np.stack([x, y, angle + math.pi / 2], 1)


def test_more_spaces_make_a_longer_lot():
    lot = make_layout(MetaDriveConfig(spaces=12))
    assert lot.num_bays == MetaDriveConfig(spaces=12).min_bays == 15
    assert float(lot.extent[0]) == pytest.approx((57.75 + 2 * 3.5) / 2 + 0.3)
    for spaces in (7, 2, True):
        with pytest.raises(ValueError, match=f"spaces must .*, not {spaces}"):
            MetaDriveConfig(spaces=spaces)

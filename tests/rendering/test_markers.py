"""Markers as geoms of a scene; needs no OpenGL."""

import mujoco
import numpy as np
import pytest

from carpark_mj.rendering.renderer import CIRCLE_SIDES, Markers


@pytest.fixture
def scene():
    model = mujoco.MjSpec().compile()
    return mujoco.MjvScene(model, 200)


def corners(geom, ends):
    """The outer corner of a flat side at one of its ends, and the inner, (2, 2)."""
    sides = np.array([[1.0, ends, 0.0], [-1.0, ends, 0.0]]) * geom.size
    return (geom.pos + sides @ geom.mat.T)[:, :2]


@pytest.mark.parametrize(("radius", "width"), [(2.0, 0.05), (0.5, 0.3)])
def test_a_circle_is_a_closed_band_of_its_radius_and_width(scene, radius, width):
    centre = np.array([3.0, -4.0, 1.0])
    Markers(scene).circle(centre, radius, (1.0, 0.0, 0.0, 1.0), width)
    sides = scene.geoms[: scene.ngeom]
    assert len(sides) == CIRCLE_SIDES
    for side, following in zip(sides, [*sides[1:], sides[0]], strict=True):
        end, start = corners(side, 1.0), corners(following, -1.0)
        np.testing.assert_allclose(end[0], start[0], atol=1e-5)
        reach = np.linalg.norm(side.pos[:2] - centre[:2])
        assert reach == pytest.approx(radius, rel=1e-5)
        assert 2 * side.size[0] == pytest.approx(width, rel=1e-5)
        assert side.size[2] < 0.02  # flat, so it hides no wheel


def test_what_mujoco_leaves_uninitialised_is_set(scene):
    """Memory of before decided the order of see-through geoms, and with it pixels."""
    scene.ngeom = 0
    for geom in scene.geoms:
        geom.camdist, geom.category, geom.objtype, geom.objid = 1e9, 77, 77, 77
        geom.segid = 77
    markers = Markers(scene)
    markers.bay(np.array([3.0, 4.0, 0.0]), np.array([5.0, 2.0]), (1.0, 0.0, 0.0, 0.5))
    markers.line(np.zeros(2), np.array([6.0, 8.0]), (1.0, 0.0, 0.0, 0.5), 0.1, 0.0)
    for k, geom in enumerate(scene.geoms[: scene.ngeom]):
        assert geom.camdist == pytest.approx(5.0, abs=0.01)  # the camera is at 0
        assert geom.category == mujoco.mjtCatBit.mjCAT_DECOR
        assert (geom.objtype, geom.objid) == (mujoco.mjtObj.mjOBJ_UNKNOWN, -1)
        assert geom.segid == k

"""Cameras: the lot fills the frame, and a driver sees the road over the bonnet."""

import dataclasses
from contextlib import closing

import mujoco
import numpy as np
import pytest
from helpers.instants import hue_distance, instant

from carpark_mj.layouts import make_layout
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene.cameras import fit_eye, frame_lot, view_yaw
from carpark_mj.scene.looks import ASPHALT, ZENITH, agent_colour
from carpark_mj.scene.markings import add_bay_numbers
from carpark_mj.vehicle import PRESETS

LAYOUT = make_layout("square")
SEEN = instant((-6.0, 0.0, 0.0), layout=LAYOUT, goal=[3], active=np.zeros(1, bool))


def seen_from(pos, quat, fovy, points):
    """Where points (n, 3) are in the frame: x and y over half its height."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, quat)
    local = (points - pos) @ axes.reshape(3, 3)
    assert (local[:, 2] < 0).all()
    return local[:, :2] / -local[:, 2:] / np.tan(np.radians(fovy) / 2)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 4 / 3, 16 / 9])
@pytest.mark.parametrize("extent", [(21.0, 21.0), (38.0, 6.0), (9.0, 20.0)])
@pytest.mark.parametrize(("camera", "fovy"), [("topdown", 30.0), ("overview", 38.0)])
def test_the_lot_fills_the_frame_and_no_corner_is_cut(camera, fovy, extent, aspect):
    pos, quat = frame_lot(camera, np.array(extent), aspect)
    corners = np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)]) * [*extent, 0]
    x, y = seen_from(pos, quat, fovy, corners).T
    assert np.abs(x).max() < aspect
    assert np.abs(y).max() < 1.0
    # At most the walls' thickness away from two opposite edges.
    assert max(np.abs(x).max() / aspect, np.abs(y).max()) > 0.8
    # The longer side lies along the frame's longer side.
    if extent[0] != extent[1] and aspect != 1.0:
        across = seen_from(pos, quat, fovy, np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
        long_across = abs(across[1, 0] - across[0, 0]) > 1e-3
        assert long_across == ((extent[0] > extent[1]) == (aspect > 1.0))


def test_no_nearer_eye_sees_all_points():
    rng = np.random.default_rng(0)
    points = rng.uniform(-5.0, 5.0, (30, 3))
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    eye = fit_eye(points, axes, 40.0, 1.5)

    def all_seen(at):
        x, y, back = ((points - at) @ axes).T
        reach = -back * np.tan(np.radians(20.0))
        inside = (np.abs(x) <= 1.5 * reach + 1e-9) & (np.abs(y) <= reach + 1e-9)
        return ((back < 0) & inside).all()

    assert all_seen(eye)
    for step in rng.uniform(-0.5, 0.5, (200, 3)):
        nearer = eye + axes @ [*step[:2], -abs(step[2]) - 1e-3]
        assert not all_seen(nearer)


def has_hue(pixels, colour):
    """Which pixels have a colour's hue, however bright."""
    return hue_distance(pixels, colour) < 8


@pytest.mark.parametrize("name", PRESETS)
def test_the_driver_sees_sky_asphalt_and_bonnet_not_the_inside_of_the_body(name):
    stage = Stage(LAYOUT, PRESETS[name], 1, 0)
    with closing(LotRenderer(stage, "driver:0", (160, 120))) as renderer:
        groups = renderer.model.geom_group.copy()
        renderer.place(SEEN)
        frame = renderer.draw(SEEN, "agent0/driver").astype(float)
        # Other cameras see the roof again.
        np.testing.assert_array_equal(renderer.model.geom_group, groups)

    def share(rows, colour):
        """Of the middle third's pixels whose hue is a colour's."""
        pixels = frame[rows, 53:107]
        bright = pixels.sum(axis=-1) > 90  # the dashboard is nearly black
        return (has_hue(pixels, colour) & bright).mean()

    assert share(slice(0, 40), ZENITH) > 0.9
    assert share(slice(58, 76), ASPHALT) > 0.7
    assert share(slice(70, 118), agent_colour(0)) > 0.1


@pytest.fixture(scope="module")
def fleet():
    """Draws the view of an agent that drives a preset, one of all of them."""
    kinds = list(PRESETS.values())
    stage = Stage(LAYOUT, kinds[0], 1, 0, kinds)
    with closing(LotRenderer(stage, "driver:0", (1280, 720))) as renderer:

        def draw(name):
            kind = np.array([list(PRESETS).index(name)])
            seen = dataclasses.replace(SEEN, kind=kind)
            renderer.place(seen)
            return renderer.draw(seen, "agent0/driver").astype(float)

        yield draw


@pytest.mark.parametrize("name", PRESETS)
def test_no_pillar_and_no_shadow_of_the_roof_cuts_the_driver_s_view(fleet, name):
    frame = fleet(name)
    paint = has_hue(frame, agent_colour(0)) & (frame.sum(axis=-1) > 90)
    paint[: len(paint) // 2] = False  # sky
    sunlit = frame.sum(axis=-1) > 0.7 * np.median(frame[paint].sum(axis=-1))
    assert sunlit[paint].mean() > 0.99
    # Below the edge of the bonnet a column shows nothing but the car.
    dashboard = frame.sum(axis=-1) < 90
    below = np.maximum.accumulate(paint, axis=0)
    assert (paint | dashboard)[below].mean() > 0.99


@pytest.mark.parametrize("name", ["square", "street_parallel"])
def test_bay_numbers_are_upright_for_the_cameras_of_the_lot(name):
    layout, spec = make_layout(name), mujoco.MjSpec()
    add_bay_numbers(spec, layout)
    right = view_yaw(np.asarray(layout.extent))
    turns = [2 * np.arctan2(geom.quat[3], geom.quat[0]) for geom in spec.geoms]
    assert len(turns) >= int(layout.bay_mask.sum())
    assert (np.cos(np.array(turns) - right) > -0.01).all()

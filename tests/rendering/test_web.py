"""The page in the browser, and what pictures add: markers, cameras, links, rings."""

import contextlib
import io
import shutil
import time
from functools import partial

import mujoco
import numpy as np
import pytest
from helpers.instants import instant

from carpark_mj.cli.pages import open_page
from carpark_mj.cli.play import PlayConfig
from carpark_mj.cli.render import RenderConfig
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.observations.fields import Tracked
from carpark_mj.rendering import web
from carpark_mj.rendering.local_pages import HOST
from carpark_mj.rendering.renderer import (
    CIRCLE_SIDES,
    LotRenderer,
    Markers,
    camera_names,
    followed_agents,
)
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.web import LiveLot
from carpark_mj.vehicle import COMPACT
from carpark_mj.wrappers.gymnasium_env import ParkEnv

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def lot():
    env = ParkingEnv(EnvConfig(num_agents=1, num_parked_cars=3))

    def policy(observation, key):
        action = np.tile(np.float32([0.5, 0.8]), (len(observation), 1))
        return action, None

    return LiveLot(env, policy, seed=0)


def place(lot):
    """Everything that moves."""
    return lot.stage.data.qpos.copy()


def where(lot):
    """The agent's rear axle in the plane."""
    return lot.stage.data.joint("agent0/root").qpos[:2].copy()


def test_a_live_lot_moves_pose_by_pose_and_starts_again_alike(lot):
    lot.reset()
    data, start, points = lot.stage.data, place(lot), [where(lot)]
    begins, way, spin = [], [], float(data.joint("agent0/spin_rl").qpos[0])
    for _ in range(16):
        begins.append(lot.step())
        way.append(place(lot))
        points.append(where(lot))
    assert begins == 4 * [True, False, False, False]  # four poses in a control step
    assert lot.seconds == pytest.approx(0.8)
    assert lot.stage.model.opt.timestep == pytest.approx(0.05)
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert moved[-1] > moved[1] > 0  # pulls away
    assert moved.max() < 0.16  # m in 0.05 s, below 3 m/s
    # Wheels roll and steer with the car.
    assert float(data.joint("agent0/spin_rl").qpos[0]) > spin
    left, right = (float(data.joint(f"agent0/steer_f{s}").qpos[0]) for s in "lr")
    assert left > right > 0.05  # Ackermann, to the left
    lot.reset()
    np.testing.assert_array_equal(place(lot), start)
    again = [(lot.step(), place(lot))[1] for _ in range(16)]
    np.testing.assert_array_equal(again, way)


@pytest.fixture(scope="module")
def page(lot):
    pytest.importorskip("mjviser")
    with open_page(8765) as server:
        viewer = web.make_live_viewer(server, lot)
        viewer._setup_gui()  # what `run` does first; the loop itself never returns
        viewer._render()
        yield f"http://{HOST}:{server.get_port()}"


@pytest.fixture
def browser(page):
    """Takes pictures (500, 800, 3) of the page as it is at the moment of the call."""
    from PIL import Image

    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as browsers:
        chromium = browsers.chromium.launch(executable_path=CHROMIUM, args=flags)
        tab = chromium.new_page(viewport={"width": 800, "height": 500})
        tab.set_default_timeout(60_000)  # ms, for machines that draw slowly
        tab.goto(page)

        def look():
            picture = Image.open(io.BytesIO(tab.screenshot()))
            return np.asarray(picture.convert("RGB"))

        yield look
        chromium.close()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to look with")
def test_a_browser_shows_the_car_in_its_colour(browser):
    blue, scene = np.zeros(0), np.zeros(0)
    for _ in range(60):  # until the meshes have come, at their own pace
        scene = browser()[:, :480].astype(int)  # the rest is under the panel
        blue = scene[..., 2] - scene[..., :2].max(axis=-1) > 40  # the car and its goal
        if blue.sum() > 100:
            break
        time.sleep(1.0)
    assert 100 < blue.sum() < 5000
    asphalt = np.ptp(scene, axis=-1) < 16
    assert asphalt.mean() > 0.2


# Pictures: markers, cameras by name, links and rings


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
    markers, red = Markers(scene), (1.0, 0.0, 0.0, 0.5)
    markers.bay(np.array([3.0, 4.0, 0.0]), np.array([5.0, 2.0]), red)
    markers.line(np.zeros(2), np.array([6.0, 8.0]), red, 0.1, 0.0)
    for k, geom in enumerate(scene.geoms[: scene.ngeom]):
        assert geom.camdist == pytest.approx(5.0, abs=0.01)  # the camera is at 0
        assert geom.category == mujoco.mjtCatBit.mjCAT_DECOR
        assert (geom.objtype, geom.objid) == (mujoco.mjtObj.mjOBJ_UNKNOWN, -1)
        assert geom.segid == k


def test_cameras_have_names_and_follow_agents():
    assert camera_names("chase:1", 2) == ("agent1/chase",)
    assert camera_names("driver:0", 2) == ("agent0/driver",)
    assert camera_names("split", 2) == ("topdown", "agent0/chase")
    assert camera_names("split:1", 2) == ("topdown", "agent1/chase")
    assert camera_names("chase:9") == ("agent9/chase",)  # of any number of agents
    for name in ("chase:2", "chase:", "chase:-1", "top", "split:2", 3):
        with pytest.raises(ValueError, match=f"unknown camera {name!r}; choose topd"):
            camera_names(name, 2)
    play, render = partial(PlayConfig, view="window"), partial(RenderConfig, "zero")
    for config in (render, play, ParkEnv):
        with pytest.raises(ValueError, match="'top'"):
            config(camera="top")
    assert followed_agents(("overview",)) == ()
    assert followed_agents(("topdown", "agent10/chase")) == (10,)


LAYOUT = make_layout("square")
POSE = np.array([[2.0, 1.0, 0.0], [-6.0, 0.0, 0.0]])
PARKED = POSE + np.array([3.0, 5.0, 0.0])  # each agent tracks the one on its left
ON_LINK, ON_RING = np.array([1.5, 2.5]), np.array([0.0, -4.0])
EXTRAS = Tracked(parked_cars=1), (8.0,)


def draw(flag, camera, *extras):
    """A picture, and the pixels of some points (2,) in it."""
    seen, stage = instant(POSE, PARKED, LAYOUT, [3, 20]), Stage(LAYOUT, COMPACT, 2, 2)
    with contextlib.closing(LotRenderer(stage, flag, (960, 360), *extras)) as renderer:
        renderer.place(seen)
        frame = renderer.draw(seen, camera).astype(int)
        points = [POSE[:, :2] + off for off in (ON_LINK, ON_RING)]
        pixels = [
            [renderer.project(np.array([*xy, 0.04]), camera) for xy in of_agents]
            for of_agents in points
        ]
    return frame, pixels


@pytest.mark.parametrize(
    ("flag", "camera", "expected"),
    [
        ("topdown", "topdown", [True, True]),
        ("split:1", "topdown", [False, True]),
        ("chase:1", "agent1/chase", [False, True]),
        ("split:0", "topdown", [True, False]),
    ],
)
def test_whose_links_and_rings_are_drawn(flag, camera, expected):
    plain, _ = draw(flag, camera)
    extra, pixels = draw(flag, camera, *EXTRAS)
    changed = np.abs(extra - plain).sum(-1) > 40

    def near(pixel):
        x, y = (round(v) for v in pixel)
        assert 2 < x < changed.shape[1] - 2
        assert 2 < y < changed.shape[0] - 2
        return bool(changed[y - 2 : y + 3, x - 2 : x + 3].any())

    for of_agents in pixels:
        assert [near(pixel) for pixel in of_agents] == expected

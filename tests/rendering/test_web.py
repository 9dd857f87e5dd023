"""The page in the browser: a lot drawn, a policy driving in it, live.

What needs the `web` extra is skipped without it, and the picture without a Chromium.
"""

import io
import shutil
import time
import urllib.request

import numpy as np
import pytest

from carpark_mj.cli.pages import open_page, show_lots
from carpark_mj.cli.scene import another
from carpark_mj.cli.settings.driving import SceneConfig
from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.rendering import web
from carpark_mj.rendering.local_pages import HOST, Chosen
from carpark_mj.rendering.web import LiveLot

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


def test_a_policy_drives_in_the_browser_only():
    with pytest.raises(ValueError, match="browser only"):
        SceneConfig(view="window", policy="runs/none")


def test_lots_chosen_on_a_page_are_shown_in_turn(capsys):
    first = SceneConfig(view="web")
    wrong = another(first, "street", 3, "none")
    shown = []

    def show(config, page):
        shown.append(config)
        if len(shown) == 1:
            raise Chosen(wrong)
        if config is wrong:
            raise ValueError("no such lot")

    show_lots(first, False, show)
    assert shown == [first, wrong, first]  # goes back to what it can show
    assert capsys.readouterr().err.count("\n") == 1
    assert (wrong.layout, wrong.seed, wrong.policy) == ("street", 3, "")
    assert another(wrong, "default", 3, "square").layout is None
    with pytest.raises(ValueError, match="no such lot"):
        show_lots(wrong, False, show)


@pytest.fixture(scope="module")
def page(lot):
    pytest.importorskip("mjviser")
    with open_page(8765) as server:
        viewer = web.make_live_viewer(server, lot)
        viewer._setup_gui()  # what `run` does first; the loop itself never returns
        viewer._render()
        yield f"http://{HOST}:{server.get_port()}"


def test_the_page_is_served(page):
    with urllib.request.urlopen(page, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()


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

"""The page in the browser: a lot drawn, a policy driving in it, live.

What needs the `web` extra is skipped without it, and the picture without a Chromium.
"""

import shutil
import subprocess
import sys
import urllib.request

import numpy as np
import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.rendering import web
from carpark_mj.rendering.live import LiveLot
from carpark_mj.scene.__main__ import SceneConfig, complete, main

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
    start, points = place(lot), [where(lot)]
    begins, way = [], []
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
    lot.reset()
    np.testing.assert_array_equal(place(lot), start)
    again = [(lot.step(), place(lot))[1] for _ in range(16)]
    np.testing.assert_array_equal(again, way)


def test_wheels_of_a_live_lot_roll_and_steer_with_the_car(lot):
    lot.reset()
    data = lot.stage.data
    spin = float(data.joint("agent0/spin_rl").qpos[0])
    for _ in range(8):
        lot.step()
    assert float(data.joint("agent0/spin_rl").qpos[0]) > spin
    left, right = (float(data.joint(f"agent0/steer_f{s}").qpos[0]) for s in "lr")
    assert left > right > 0.05  # Ackermann, to the left


def test_without_the_extra_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mjviser", None)
    for settings in ({}, {"policy": "runs/none"}):
        with pytest.raises(OSError, match=r"pip install 'carpark_mj\[web\]'"):
            main(SceneConfig(view="web", **settings))


def test_view_alone_opens_a_window():
    assert complete(["--view"]) == ["--view", "window"]
    assert complete(["--view", "--seed", "3"]) == ["--view", "window", "--seed", "3"]
    assert complete(["--view", "web"]) == ["--view", "web"]
    with pytest.raises(ValueError, match="browser only"):
        SceneConfig(view="window", policy="runs/none")


@pytest.fixture(scope="module")
def page(lot):
    pytest.importorskip("mjviser")
    viewer, server = web.make_live_viewer(lot, port=8765)
    viewer._setup_gui()  # what `run` does first; the loop itself never returns
    viewer._render()
    yield f"http://{web.HOST}:{server.get_port()}"
    server.stop()


def test_the_page_is_served(page):
    with urllib.request.urlopen(page, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to look with")
def test_a_browser_shows_the_car_in_its_colour(page, tmp_path):
    from PIL import Image

    path = tmp_path / "page.png"
    flags = "--headless=new --no-sandbox --use-angle=swiftshader --window-size=800,500"
    command = [str(CHROMIUM), *flags.split(), "--enable-unsafe-swiftshader"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={path}"]
    command += ["--virtual-time-budget=20000", page]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    scene = picture[:, :480]  # the rest is under the panel
    blue = scene[..., 2] - scene[..., :2].max(axis=-1) > 40  # the car and its goal
    assert 100 < blue.sum() < 5000
    asphalt = np.ptp(scene, axis=-1) < 16
    assert asphalt.mean() > 0.2

"""The browser demo: built, and driven in headless Chromium where there is one."""

import functools
import http.server
import importlib.util
import json
import math
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from carpark_mj.mdp.terminations import is_parked
from carpark_mj.scene.build import drivable_scene, scene_xml
from carpark_mj.types import Motion

pytestmark = pytest.mark.slow
plain_values = pytest.importorskip("carpark_formats.onnx.car").plain_values

DEMO = Path(__file__).parents[1] / "docs" / "demo"
LOT = "angled"  # the page's first
MINUTE = 60.0  # s of simulated time
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
WAIT = 240_000  # ms, for machines that draw and simulate slowly


@pytest.fixture(scope="module")
def build():
    spec = importlib.util.spec_from_file_location("demo_build", DEMO / "build.py")
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def page():
    """A function that opens a folder's page; it logs requests and complaints."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    if CHROMIUM is None:
        pytest.skip("needs Chromium")

    class Handler(http.server.SimpleHTTPRequestHandler):
        extensions_map = {  # noqa: RUF012
            **http.server.SimpleHTTPRequestHandler.extensions_map,
            ".wasm": "application/wasm",
            ".mjs": "text/javascript",
        }

        def log_message(self, format, *args):
            pass

    servers = []

    def serve(folder):
        handler = functools.partial(Handler, directory=folder)
        servers.append(http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler))
        threading.Thread(target=servers[-1].serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{servers[-1].server_port}/"

    with playwright.sync_playwright() as browsers:
        browser = browsers.chromium.launch(executable_path=CHROMIUM, args=FLAGS)

        def show(folder, query=""):
            page = browser.new_page(viewport={"width": 320, "height": 240})
            page.requests, page.complaints, page.origin = [], [], serve(folder)
            page.on("request", lambda request: page.requests.append(request.url))
            page.on("pageerror", lambda error: page.complaints.append(str(error)))
            page.on(
                "console",
                lambda line: (
                    line.type in ("error", "warning")
                    and page.complaints.append(line.text)
                ),
            )
            page.goto(f"{page.origin}index.html?{query}")
            return page

        yield show
        browser.close()
    for server in servers:
        server.shutdown()
        server.server_close()


@pytest.fixture(scope="module")
def driven(build, page, tmp_path_factory):
    """The built page, in which half of the cars have parked, or a minute is over."""
    folder = tmp_path_factory.mktemp("site") / "demo"
    ignored = shutil.ignore_patterns("built", "__pycache__")
    shutil.copytree(DEMO, folder, ignore=ignored)
    if shutil.which("npm") is None:
        pytest.skip("needs npm")
    try:
        build.vendor(folder / "built")
    except subprocess.CalledProcessError:
        pytest.skip("npm cannot install the packages")
    assert next(iter(build.LOTS)) == LOT
    build.export(folder / "built", [LOT], build.CARS[:1])
    page = page(folder, "speed=9")
    page.built = folder / "built"
    page.wait_for_function(
        "demo.report && (new Set(demo.events.map((event) => event.car)).size >= "
        f"demo.lot.start.length / 2 || demo.report.time >= {MINUTE})",
        timeout=WAIT,
        polling=200,
    )
    return page


def test_a_page_that_is_not_built_tells_how_to_build_it(page, tmp_path):
    ignored = shutil.ignore_patterns("built", "__pycache__")
    shutil.copytree(DEMO, tmp_path / "demo", ignore=ignored)
    page = page(tmp_path / "demo")
    hint = page.locator("#status", has_text="python docs/demo/build.py")
    hint.wait_for(timeout=WAIT)


def test_the_page_asks_no_other_server_and_complains_of_nothing(driven):
    assert len(driven.requests) > 10
    assert all(
        url.startswith((driven.origin, "data:", "blob:")) for url in driven.requests
    )
    software = "GPU stall due to ReadPixels"  # of Chromium without a GPU
    assert [line for line in driven.complaints if software not in line] == []


def test_cars_park_within_a_minute_by_the_strict_rule(build, driven):
    env, state, _ = build.begin(build.LOTS[LOT])
    events = driven.evaluate("demo.events")
    parked = [e for e in events if e["kind"] == "parked" and e["time"] <= MINUTE]
    assert len({event["car"] for event in parked}) >= env.num_agents / 2
    for event in parked:
        pose = jnp.array(event["pose"])
        motion = Motion(
            pose_w=pose,
            velocity_b=jnp.array([event["speed"], event["drift"]]),
            yaw_rate=jnp.zeros(()),
            steering=jnp.zeros(()),
            size=state.motion.size[0],
            trace_w=pose[None],
            finite=jnp.array(True),
        )
        layout, number = state.layout, event["goal"]  # of the bays that there are
        goal = np.flatnonzero(layout.bay_mask)[number]
        bay = layout.bay_pose[goal], layout.bay_size[goal]
        assert is_parked("strict", motion, *bay)


def test_the_first_decisions_are_those_of_python(build, driven):
    onnxruntime = pytest.importorskip("onnxruntime")
    _, state, _ = build.begin(build.LOTS[LOT])
    known = plain_values(build.model_rows(), state)
    known = {k: np.asarray(x) for k, x in known.items()}
    session = onnxruntime.InferenceSession(driven.built / "policy.onnx")
    first = driven.evaluate(
        "demo.first.map(({car, inputs, action}) => [car, action, Object.fromEntries("
        "Object.entries(inputs).map(([name, {array}]) => [name, Array.from(array)]))])"
    )
    assert [car for car, *_ in first] == list(range(len(state.goal)))
    for car, action, inputs in first:
        own = {x.name: known[x.name][car, ...] for x in session.get_inputs()}
        for name, value in own.items():
            there = np.reshape(inputs[name], value.shape)
            mask = own.get(name.split("_")[0] + "_mask", np.array(True))
            if mask.ndim and name.split("_")[0] + "_mask" != name:
                there, value = there[mask], value[mask]
            np.testing.assert_allclose(there, value, atol=1e-5, err_msg=name)
        [expected] = session.run(None, own)
        np.testing.assert_allclose(action, expected, atol=1e-4)


def towards(yaw):
    return np.array([np.cos(yaw), np.sin(yaw)])


def test_keys_drive_the_first_car_and_give_it_back(driven, page):
    driven.evaluate("demo.worker.postMessage({ paused: true })")
    page = page(driven.built.parent)
    page.wait_for_function("demo.report", timeout=WAIT)
    for key in ("ArrowUp", "ArrowLeft"):
        page.keyboard.down(key)
    page.wait_for_function(
        "demo.report.manual && demo.report.cars[0].begun > 0 && "
        "demo.report.cars[0].speed > 0.3 && demo.report.cars[0].steering > 0.1",
        timeout=WAIT,
    )
    for key in ("ArrowUp", "ArrowLeft"):  # which would take the wheel again
        page.keyboard.up(key)
    page.keyboard.press("KeyP")
    page.wait_for_function("!demo.report.manual", timeout=WAIT)
    page.close()
    driven.evaluate("demo.worker.postMessage({ paused: false })")


def test_people_walk_outside_of_parked_cars_and_are_seen(build, driven, page):
    driven.evaluate("demo.worker.postMessage({ paused: true })")
    page = page(driven.built.parent, f"speed=9&people={build.PEOPLE}")
    page.wait_for_function("demo.report", timeout=WAIT)
    page.evaluate(
        "globalThis.seen = []; demo.worker.addEventListener('message', ({ data }) => "
        "data.people && seen.push(data.people))"
    )
    end = page.evaluate("demo.report.time") + MINUTE
    page.wait_for_function(f"demo.report.time > {end}", timeout=WAIT)
    lot, seen, first = page.evaluate("[demo.lot, seen, demo.first[0].inputs]")
    people = np.array(seen)  # (reports, people, 2)
    assert people.shape[1] == build.PEOPLE
    assert (np.ptp(people, axis=0).max(axis=-1) > 3.0).all()  # m
    known = {name: np.array(value) for name, value in lot["inputs"].items()}
    x, y, yaw = known["parked_pose"][known["parked_mask"]].T
    to = (people[..., None] - np.stack([x, y])).swapaxes(-2, -1)  # from parked cars
    along, left = towards(yaw), towards(yaw + math.pi / 2)
    inside = [abs((to * axis.T).sum(axis=-1)) for axis in (along, left)]
    assert not (np.stack(inside, axis=-1) < known["size"] / 2).all(axis=-1).any()
    assert sum(first["disc_mask"]["array"]) == build.PEOPLE
    page.close()
    driven.evaluate("demo.worker.postMessage({ paused: false })")


def test_the_scene_for_an_older_mujoco_drives_alike(build):
    env, state, _ = build.begin(build.LOTS[LOT])
    poses = np.asarray(state.motion.pose_w), np.asarray(state.parked_cars.pose_w)
    xml = scene_xml(drivable_scene(state.layout, env.vehicle, *poses), env.vehicle)
    ends = []
    for text in (xml, build.for_older_mujoco(xml)):
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.ctrl[0::3], data.ctrl[1::3] = 0.3, 0.5
        mujoco.mj_step(model, data, 500)
        ends.append(data.joint("agent0/root").qpos)
    np.testing.assert_allclose(*ends, atol=1e-6)


def test_packages_are_pinned_and_listed(build):
    package = json.loads((DEMO / "package.json").read_text())
    listed = {name for name, *_ in build.MODULES.values()}
    assert package["dependencies"].keys() == listed
    assert all(version[0].isdigit() for version in package["dependencies"].values())

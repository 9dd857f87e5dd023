"""Exported scenes: whole, at rest, and driving without this project."""

import json
import math
import re
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from helpers.programs import ROOT, python

from carpark_mj.cli.scene import SceneConfig, default_env, main, make_scene
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.scene import parts
from carpark_mj.scene.build import drivable_scene
from carpark_mj.vehicle import COMPACT
from carpark_mj.vehicle.mjcf import WHEELS
from carpark_mj.vehicle.parameters import GRAVITY

ROOMY = 11  # seed of a start with room for a circle to the left and 12 m ahead


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.xml"
    main(SceneConfig(out=str(path)))
    return path


@pytest.fixture(scope="module")
def model(exported):
    return mujoco.MjModel.from_xml_path(str(exported))


def run(model, data, seconds):
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))


def drive_alone(path):
    """Runs the example's script, which must not need this project."""
    return python("-I", ROOT / "examples" / "drive_scene.py", path)


def test_the_file_is_whole_and_the_same_model(exported, model):
    text = exported.read_text()
    assert "file=" not in text  # no mesh or texture of its own
    assert "agentK/steer" in text.split("<mujoco")[0]  # the guide comes first
    assert ElementTree.fromstring(text).tag == "mujoco"  # for other readers of XML
    spec, _ = make_scene(SceneConfig(out="x.xml"))
    built = spec.compile()
    assert [model.actuator(k).name for k in range(model.nu)] == [
        f"agent{k}/{c}" for k in range(2) for c in ("steer", "drive", "brake")
    ]
    for field in ("body_mass", "body_inertia", "body_pos", "jnt_type", "eq_data"):
        np.testing.assert_allclose(
            getattr(model, field), getattr(built, field), rtol=1e-4, atol=1e-6
        )


def test_nothing_moves_when_nobody_touches_it(model):
    data = mujoco.MjData(model)
    start = data.qpos.copy()
    highest = 0.0
    for _ in range(10):
        run(model, data, 1.0)
        highest = max(highest, float(np.abs(data.qpos - start).max()))
    assert highest < 1e-3  # metres and radians, every car; measured 1e-5
    assert data.ncon == 4 * 2  # eight tyres on the ground and nothing else
    assert not any(warning.number for warning in data.warning)


@pytest.fixture(scope="module")
def empty(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "empty.xml"
    main(SceneConfig(out=str(path), num_agents=1, num_parked_cars=0, seed=ROOMY))
    return path


def test_a_script_without_carpark_mj_drives_stops_and_stands(empty):
    done = drive_alone(empty)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    assert not measured["imported_carpark_mj"]
    assert measured["speed_m_s"] == pytest.approx(1.5, abs=0.1)
    radius = COMPACT.wheelbase / math.tan(math.radians(30))
    assert measured["wheelbase_over_tan_delta_m"] == pytest.approx(radius)
    assert measured["circle_radius_m"] == pytest.approx(radius, rel=0.01)
    assert abs(measured["speed_after_braking_m_s"]) < 1e-6
    assert measured["stopping_distance_m"] < 0.4
    assert measured["drift_at_rest_in_10_s_mm"] < 1.0


def test_a_car_without_room_is_reported_instead_of_measured(tmp_path):
    path = tmp_path / "tight.xml"
    main(SceneConfig(out=str(path), num_agents=1, num_parked_cars=0, seed=0))
    done = drive_alone(path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "the car hit something after" in done.stderr


def test_the_sliders_do_what_the_guide_says(empty):
    text, model = empty.read_text(), mujoco.MjModel.from_xml_path(str(empty))
    data = mujoco.MjData(model)
    grip = COMPACT.tyre.friction * GRAVITY  # of the full brake
    assert f"slide at\n                  {grip:.1f} m/s^2" in text
    ((limit, loss),) = re.findall(
        r"this\s+times ([\d.]+) m/s(?:, less\s+([\d.]+) m/s)?", text
    )
    data.actuator("agent0/drive").ctrl = 0.5
    run(model, data, 8.0)
    speed = np.linalg.norm(data.joint("agent0/root").qvel[:2])
    assert speed == pytest.approx(0.5 * float(limit) - float(loss or 0), abs=0.02)


@pytest.mark.parametrize("suspension", [False, True])
def test_the_full_brake_holds_on_a_slope_and_leaves_springs_free(suspension):
    lot = make_layout("square")
    spec = drivable_scene(lot, COMPACT, np.zeros((1, 3)), np.zeros((0, 3)), suspension)
    model = spec.compile()
    data = mujoco.MjData(model)
    root = data.joint("agent0/root")
    # A stop from 3 m/s: with the brake still on, the car comes back up from its dive.
    height, yaw = float(root.qpos[2]), 2 * math.atan2(root.qpos[6], root.qpos[3])
    root.qvel[:2] = 3.0 * math.cos(yaw), 3.0 * math.sin(yaw)
    for wheel in WHEELS:  # they roll
        data.joint(f"agent0/spin_{wheel}").qvel = 3.0 / COMPACT.wheel_radius
    data.actuator("agent0/brake").ctrl = 1.0
    run(model, data, 3.0)
    assert np.abs(root.qvel).max() < 2e-3
    assert float(root.qpos[2]) == pytest.approx(height, abs=1e-3)
    slope = math.atan(0.2)
    model.opt.gravity = -GRAVITY * np.array([math.sin(slope), 0.0, math.cos(slope)])
    run(model, data, 3.0)
    start = root.qpos[:2].copy()
    run(model, data, 3.0)
    assert np.linalg.norm(root.qpos[:2] - start) < 3.0 * 1e-3 / 60  # 1 mm a minute


def test_cars_walls_and_parked_cars_collide(model):
    """An agent is set down beside a parked car and driven into it, then a wall."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    parked = model.body("parked0").id
    pose, turn = data.xpos[parked].copy(), data.xquat[parked].copy()
    forward = data.xmat[parked].reshape(3, 3)[:, 0]
    # Nose to nose, one metre apart, facing each other.
    root, facing = data.joint("agent0/root"), np.zeros(4)
    gap = 2 * (COMPACT.length - COMPACT.rear_overhang) + 1.0
    root.qpos[:2] = (pose + gap * forward)[:2]
    mujoco.mju_mulQuat(facing, turn, np.array([0.0, 0.0, 0.0, 1.0]))
    root.qpos[3:] = facing
    data.actuator("agent0/drive").ctrl = 1.0
    run(model, data, 3.0)
    moved = data.xpos[parked] - pose
    assert moved @ forward < -0.05  # pushed back into its bay
    reach = (data.xpos[model.body("agent0/car").id] - data.xpos[parked]) @ forward
    assert reach > 2 * (COMPACT.length - COMPACT.rear_overhang) - 0.1  # not through it
    run(model, data, 10.0)  # against the wall behind the bay
    assert np.abs(data.xpos[1:, :2]).max() < 21.1


@pytest.mark.parametrize("layout", ["metadrive", "tpcap_3", "lot", "street"])
def test_every_lot_opens_by_its_name_alone(layout):
    assert ParkingEnv(default_env(SceneConfig(layout=layout, out="x.xml")))


def test_looks_change_no_mass_and_no_motion(monkeypatch):
    """The same drive, bit for bit, in scenes with and without the cars' looks."""

    def drive():
        spec, _ = make_scene(SceneConfig(out="x.xml", num_parked_cars=2))
        model = spec.compile()
        data = mujoco.MjData(model)
        data.ctrl[:3] = [0.3, 1.0, 0.0]
        run(model, data, 0.5)
        return model, data

    with_looks, moved = drive()
    monkeypatch.setattr(parts, "add_looks", lambda *_: None)
    without, expected = drive()
    assert with_looks.nmesh > without.nmesh
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_M0"):
        np.testing.assert_array_equal(getattr(with_looks, name), getattr(without, name))
    np.testing.assert_array_equal(moved.qpos, expected.qpos)
    assert np.abs(moved.qvel).max() > 0.3
    looks = with_looks.geom_group == 2
    assert not with_looks.geom_contype[looks].any()
    assert not with_looks.geom_conaffinity[looks].any()

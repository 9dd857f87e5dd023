"""ParkBench's format: lots are what the files say, of which half is held out."""

import dataclasses
import json
import math

import jax
import numpy as np
import pytest
from helpers.scenes import polygons

from carpark_formats.exchange import import_layout
from carpark_formats.parkbench import MARGIN, PARKBENCH_CAR, read_parkbench
from carpark_formats.settings import ImportConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts.files import read_json
from carpark_mj.layouts.types import BayEnd
from carpark_mj.policy.named import zero_policy
from carpark_mj.registry import ANYWHERE
from carpark_mj.suite.evaluation import CaseEvaluator, SuiteConfig, suite_env
from carpark_mj.suite.levels import find_level, pick_cases
from carpark_mj.suite.tpcap import EDGE
from carpark_mj.suite.tpcap import START as START_SIDE

START, GOAL = (4.0, 3.0, 0.2), (-3.0, 1.0, 1.5)  # of the rear axle


def parked(x, y):
    """A point in the frame of the rear axle of the parked car."""
    cosine, sine = math.cos(GOAL[2]), math.sin(GOAL[2])
    return GOAL[0] + cosine * x - sine * y, GOAL[1] + sine * x + cosine * y


# 0.1 m beside the car.
SIDE = [parked(-1.0, 1.1 + EDGE), parked(3.5, 1.1 + EDGE), parked(4.5, 1.6)]
FAR = [(30.0, 0.0), (31.0, 0.0)]
ACROSS = [parked(2.0, -2.0), parked(2.0, 0.0)]  # where the car parks


def document(lines=(SIDE, FAR, ACROSS, [(0.0, 0.0)]), shift=None, areas=False):
    """A case; `shift` moves its planner's origin, and that of its frame."""
    posture = {"m_pose": list(GOAL), "m_curvature": 0.0}
    request = {"m_startPosture": {"m_pose": list(START)}}
    frame = {
        "PlanningRequest": request,
        "NfmAggregatedPolygonObjects": [
            {"nfmPolygonObjectNodes": [{"m_x": x, "m_y": y} for x, y in line]}
            for line in lines
        ],
    }
    if areas:
        request["m_targetAreas"] = {"m_targetPosture": [posture]}
    else:
        request["m_targetArea"] = {"m_targetPosture": posture}
    if shift:
        request["m_origin"] = [7.0 + shift[0], -3.0 + shift[1]]
        frame["m_nfmOrigin"] = [7.0, -3.0]
    return {"Frames": {"0": frame}}


def write(path, *args, **more):
    path.write_text(json.dumps(document(*args, **more)))
    return path


def axle(pose):
    ahead = PARKBENCH_CAR.centre_offset
    return pose[:2] - ahead * np.array([math.cos(pose[2]), math.sin(pose[2])])


@pytest.mark.parametrize("areas", [False, True])
@pytest.mark.parametrize("shift", [None, (0.3, -0.2)])
def test_a_lot_is_its_file(tmp_path, areas, shift):
    lot = jax.device_get(
        read_parkbench(write(tmp_path / "1.json", shift=shift, areas=areas))
    )
    [bay], [spawn] = lot.bay_pose.astype(float), lot.spawn_pose.astype(float)
    expected = np.subtract(GOAL[:2], START[:2])
    np.testing.assert_allclose(axle(bay) - axle(spawn), expected, atol=1e-5)
    for mine, theirs in ((spawn[2], START[2]), (bay[2], GOAL[2])):
        assert math.remainder(mine - theirs, math.tau) == pytest.approx(0, abs=1e-6)
    assert lot.bay_end.tolist() == [BayEnd.TAIL_FIRST]
    # Both pieces at the car's side are near, and out of its way.
    mask = lot.wall_mask
    assert mask.tolist() == [True, True]
    np.testing.assert_allclose(
        lot.wall_size[:, 0], [4.5, math.hypot(1.0, 0.5 - EDGE)], 1e-5
    )
    np.testing.assert_allclose(lot.wall_size[:, 1], EDGE)
    gap = np.subtract(np.mean(SIDE[:2], axis=0), GOAL[:2]) - (shift or (0.0, 0.0))
    found = lot.wall_pose[0, :2] - axle(bay)
    np.testing.assert_allclose(found, gap, atol=1e-5)


def test_the_bay_is_larger_where_walls_leave_room(tmp_path):
    wide = jax.device_get(read_parkbench(write(tmp_path / "1.json", [FAR])))
    size = np.array(PARKBENCH_CAR.size)
    np.testing.assert_allclose(wide.bay_size[0], size + 2 * MARGIN, rtol=1e-6)
    tight = jax.device_get(read_parkbench(write(tmp_path / "2.json")))
    margin = (tight.bay_size[0] - size) / 2
    assert margin.min() >= 0.0
    assert margin.max() < MARGIN / 2
    [bay] = polygons(tight.bay_pose, tight.bay_size)
    assert not any(
        wall.intersects(bay) for wall in polygons(tight.wall_pose, tight.wall_size)
    )


def test_a_case_is_imported(tmp_path, capsys):
    path, out = write(tmp_path / "1.json"), tmp_path / "lot.json"
    import_layout(ImportConfig(str(path), str(out)))
    assert "2 pieces" in capsys.readouterr().out
    found, expected = read_json(out), read_parkbench(path)
    for name in ("bay_pose", "bay_end", "wall_pose", "wall_size", "spawn_pose"):
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), atol=1e-6
        )


def test_half_of_the_files_is_held_out(tmp_path):
    for number in (5, 1, 4, 2, 3):
        write(tmp_path / f"{number}.json", [FAR, SIDE][: number % 3])
    names = f"parkbench:{tmp_path}", f"parkbench:{tmp_path}:held_out"
    work, held_out = map(find_level, names)
    assert (list(work.numbers), list(held_out.numbers)) == ([0, 2, 4], [1, 3])
    assert work.sha256 != held_out.sha256
    cases = pick_cases(names[0], 2, first=1)
    assert (cases.level, cases.number.tolist()) == (names[0], [2, 4])
    assert cases.layouts.wall_mask.sum(axis=1).tolist() == [0, 2]
    assert SuiteConfig(("zero",), levels=names, videos=1)
    for level in ("parkbench", "scenario:"):
        with pytest.raises(ValueError, match=f"{level.strip(':')}:F"):
            find_level(level)
    with pytest.raises(ValueError, match="has only 0 ParkBench files"):
        find_level(f"parkbench:{tmp_path / 'none'}")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda frame: frame.pop("PlanningRequest"), "PlanningRequest"),
        (lambda frame: frame.update(m_nfmOrigin=[math.nan, 0.0]), "not a finite"),
        (lambda frame: frame.update(m_nfmOrigin="here"), "no case of ParkBench"),
        (lambda frame: None, "a car at the start would stand in an obstacle"),
    ],
)
def test_faulty_cases_are_refused_with_their_file(tmp_path, change, message):
    data = document([[(START[0], START[1] + y) for y in (-2, 2)]])
    change(data["Frames"]["0"])
    path = tmp_path / "1.json"
    path.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=f"1.json: .*{message}"):
        read_parkbench(path)


def test_a_car_of_a_data_sheet_begins_at_the_recorded_pose(tmp_path):
    write(tmp_path / "1.json")
    sheet = tmp_path / "car.yaml"
    sheet.write_text("length: 4.95 m\nwidth: 2.0 m\nwheelbase: 2.95 m\n")
    level = f"parkbench:{tmp_path}"
    config = find_level(level).env(suite_env(ANYWHERE, "precise", vehicle=str(sheet)))
    short = dataclasses.replace(config.episode, max_steps=2)
    env = ParkingEnv(dataclasses.replace(config, episode=short))
    cases = pick_cases(level, 1)
    rows, drives = CaseEvaluator(env).drive(zero_policy(env.action_spec), cases, seed=0)
    assert [row["timed_out"] for row in rows] == [1.0]
    np.testing.assert_allclose(
        drives.pose_w[0, 1, 0, -1], cases.layouts.spawn_pose[0, 0], atol=START_SIDE
    )

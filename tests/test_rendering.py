"""Off-screen pictures: things are where they should be, and say what they are."""

import os

import numpy as np
import pytest

from carpark_mj.layouts import make_layout
from carpark_mj.rendering import gl
from carpark_mj.rendering.overlays import draw_labels, draw_status
from carpark_mj.rendering.renderer import (
    LotRenderer,
    RenderingError,
    camera_name,
)
from carpark_mj.rendering.rollout import Recording
from carpark_mj.rendering.video import (
    draw_frame,
    frame_stride,
    frames_per_second,
    write_mp4,
)
from carpark_mj.scene.materials import agent_colour
from carpark_mj.vehicle import COMPACT

LAYOUT = make_layout("tanner")
POSE = np.array([[5.0, 3.0, 0.4], [-6.0, -4.0, 2.0]])
GOAL = np.array([3, 20])
PARKED = np.asarray(LAYOUT.bay_pose)[[10, 30]]


@pytest.fixture(scope="module")
def renderer():
    # No skip without GL: CI installs it, and a silent skip would hide its loss.
    made = LotRenderer(LAYOUT, COMPACT, 2, 2, "topdown", (640, 360))
    yield made
    made.close()


def draw(renderer, pose=POSE, goal=GOAL, parked=PARKED):
    return renderer.render(pose, np.zeros(len(pose)), goal, parked)


def hue_distance(pixel, colour):
    """Angle between colours, blind to how bright the light makes them."""
    a, b = np.asarray(pixel, float), np.asarray(colour[:3], float)
    cos = a @ b / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-9)
    return np.degrees(np.arccos(np.clip(cos, -1, 1)))


def patch(frame, pixel):
    x, y = (round(v) for v in pixel)
    return frame[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).mean(axis=0)


def ahead(pose, distance):
    x, y, yaw = pose
    return np.array([x + distance * np.cos(yaw), y + distance * np.sin(yaw), 0.8])


def test_cars_are_drawn_in_their_colour_where_their_poses_are(renderer):
    frame = draw(renderer)
    for agent in (0, 1):
        bonnet = renderer.project(ahead(POSE[agent], 1.65))
        assert hue_distance(patch(frame, bonnet), agent_colour(agent)) < 10


def test_a_car_is_centred_on_its_footprint(renderer):
    """The painted body ends half a length ahead of and behind the pose."""
    frame = draw(renderer)
    body = agent_colour(0)
    for reach, drawn in ((1.9, True), (2.35, False), (-1.9, True), (-2.35, False)):
        found = hue_distance(
            patch(frame, renderer.project(ahead(POSE[0], reach))), body
        )
        assert (found < 20) == drawn, (reach, found)


def test_goals_are_filled_with_the_agent_s_colour_and_free_bays_are_not(renderer):
    frame = draw(renderer)
    for agent, bay in enumerate(GOAL):
        # Off the centre: the line from the car ends there.
        x, y, yaw = np.asarray(LAYOUT.bay_pose[bay])
        spot = (x + 0.9 * np.cos(yaw + 1.2), y + 0.9 * np.sin(yaw + 1.2), 0.0)
        pixel = patch(frame, renderer.project(np.array(spot)))
        assert hue_distance(pixel, agent_colour(agent)) < 15
        free = patch(frame, renderer.project(np.array([*LAYOUT.bay_pose[15][:2], 0])))
        assert hue_distance(free, agent_colour(agent)) > 12


def test_parked_cars_stand_in_their_bays_and_move_when_told(renderer):
    before = draw(renderer).astype(int)
    after = draw(renderer, parked=np.asarray(LAYOUT.bay_pose)[[10, 12]]).astype(int)

    def change(bay):
        centre = np.array([*np.asarray(LAYOUT.bay_pose[bay])[:2], 0.0])
        return np.abs(
            patch(after, renderer.project(centre))
            - patch(before, renderer.project(centre))
        ).sum()

    assert change(30) > 60
    assert change(12) > 60
    assert change(10) < 3


def test_labels_carry_the_agents_colours_at_cars_and_goals(renderer):
    frame = draw(renderer)
    bay_pose = np.asarray(LAYOUT.bay_pose)[GOAL]
    labelled = draw_labels(frame, renderer, POSE, bay_pose)
    changed = (labelled != frame).any(axis=-1)
    for agent in (0, 1):
        for point, height in ((POSE[agent], 1.7), (bay_pose[agent], 0.0)):
            x, y = renderer.project(np.array([point[0], point[1], height]))
            assert changed[round(y), round(x) - 6]
            colour = tuple(round(255 * c) for c in agent_colour(agent)[:3])
            box = labelled[round(y) - 9 : round(y) + 10, round(x) - 9 : round(x) + 10]
            assert (box == colour).all(axis=-1).sum() > 50


def test_the_status_is_written_in_the_top_left_corner_only(renderer):
    frame = draw(renderer)
    changed = (draw_status(frame, ["12.0 s", "parked 3"]) != frame).any(axis=-1)
    rows, columns = np.nonzero(changed)
    assert rows.max() < 80
    assert columns.max() < 200
    assert changed.sum() > 500


def test_cameras_are_refused_by_name():
    assert camera_name("chase:1", 2) == "agent1/chase"
    for name in ("chase:2", "chase:", "chase:-1", "top", ""):
        with pytest.raises(RenderingError, match="choose topdown, overview or chase:K"):
            camera_name(name, 2)


def test_missing_gl_is_one_sentence_with_the_package_to_install(monkeypatch):
    monkeypatch.setattr(gl, "_LIBRARIES", {"egl": "libnone.so", "osmesa": "libno.so"})
    monkeypatch.setattr(gl.sys, "platform", "linux")
    for wanted in ("egl", ""):
        monkeypatch.setenv("MUJOCO_GL", wanted)
        assert "apt install libegl1" in gl.choose_gl()
        # MuJoCo must still import, for training without pictures.
        assert "MUJOCO_GL" not in os.environ


def recording(steps=3, traces=4):
    pose = np.tile(POSE, (steps, traces, 1, 1))
    no = np.zeros((steps, 2), bool)
    return Recording(
        layout=LAYOUT,
        ctrl_dt=0.2,
        pose_w=pose,
        steering=np.zeros((steps, 2)),
        goal=np.tile(GOAL, (steps, 1)),
        parked_pose=np.tile(PARKED, (steps, 1, 1)),
        active=~no,
        parked=no,
        crashed=no,
        timed_out=no,
        step=np.ones((steps, 2), int),
    )


def test_videos_play_in_real_time(renderer, tmp_path):
    import imageio_ffmpeg

    story = recording()
    assert frames_per_second(story) == pytest.approx(20.0)
    assert [frame_stride(story, fps) for fps in (60, 20, 10, 5)] == [1, 1, 2, 4]
    path = tmp_path / "a.mp4"
    pictures = (draw_frame(story, renderer, k) for k in range(12))
    assert write_mp4(path, pictures, 20.0) == 12
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert meta["size"] == (640, 360)
    assert meta["fps"] == pytest.approx(20.0)
    assert sum(1 for _ in reader) == 12
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_a_failing_picture_leaves_no_half_video(tmp_path):
    def pictures():
        yield np.zeros((64, 64, 3), np.uint8)
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        write_mp4(tmp_path / "a.mp4", pictures(), 10.0)
    assert list(tmp_path.iterdir()) == []

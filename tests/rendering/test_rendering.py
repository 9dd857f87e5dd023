"""Off-screen pictures, and what is told where nothing can draw."""

import contextlib
import dataclasses
import os

import jax
import numpy as np
import pytest
from helpers.instants import hue_distance, instant

from carpark_mj.layouts import layout_config, make_layout
from carpark_mj.rendering import gl
from carpark_mj.rendering.recording import (
    FLASH_SECONDS,
    Recording,
    frames_per_second,
    num_frames,
    snapshot,
)
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.video import (
    draw_frame,
    draw_labels,
    frame_indices,
    write_video,
)
from carpark_mj.scene.looks import agent_colour
from carpark_mj.types import NO_BAY
from carpark_mj.vehicle import COMPACT

LAYOUT = make_layout("square")
POSE = np.array([[5.0, 3.0, 0.4], [-6.0, -4.0, 2.0]])
GOAL = np.array([3, 20])
BAYS = np.asarray(LAYOUT.bay_pose)
PARKED = BAYS[[10, 30]]


def seen(goal=GOAL, parked=PARKED, **changes):
    """Two agents on their way."""
    told = {"state": ("drives",) * 2, "tally": {"parked": 3, "crashed": 0}}
    return instant(POSE, parked, LAYOUT, goal, seconds=1.0, **told, **changes)


@pytest.fixture(scope="module")
def renderer():
    # No skip without GL: CI installs it, and a silent skip would hide its loss.
    made = LotRenderer(Stage(LAYOUT, COMPACT, 2, 2), "topdown", (640, 360))
    yield made
    made.close()


def draw(renderer, **changes):
    what = seen(**changes)
    renderer.place(what)
    return renderer.draw(what, "topdown")


def project(renderer, point):
    return renderer.project(np.asarray(point, float), "topdown")


def patch(frame, pixel):
    x, y = (round(v) for v in pixel)
    return frame[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 3).mean(axis=0)


def ahead(pose, distance):
    x, y, yaw = pose
    return np.array([x + distance * np.cos(yaw), y + distance * np.sin(yaw), 0.8])


def test_cars_are_drawn_in_their_colour_where_their_poses_are(renderer):
    """The painted body ends half a length ahead of and behind the pose."""
    frame = draw(renderer)
    for agent, pose in enumerate(POSE):
        bonnet = project(renderer, ahead(pose, 1.65))
        assert hue_distance(patch(frame, bonnet), agent_colour(agent)) < 10
    for reach, drawn in ((1.9, True), (2.35, False), (-1.9, True), (-2.35, False)):
        end = patch(frame, project(renderer, ahead(POSE[0], reach)))
        assert (hue_distance(end, agent_colour(0)) < 20) == drawn, reach


def test_labels_carry_the_agents_colours_at_cars_and_goals(renderer):
    frame = draw(renderer)
    bay_pose = BAYS[GOAL]
    labelled = draw_labels(frame, renderer, seen(), "topdown")
    changed = (labelled != frame).any(axis=-1)
    for agent in (0, 1):
        for point, height in ((POSE[agent], 1.7), (bay_pose[agent], 0.0)):
            x, y = project(renderer, [point[0], point[1], height])
            assert changed[round(y), round(x) - 6]
            colour = tuple(round(255 * c) for c in agent_colour(agent)[:3])
            box = labelled[round(y) - 9 : round(y) + 10, round(x) - 9 : round(x) + 10]
            assert (box == colour).all(axis=-1).sum() > 50


def recording(steps=3, traces=4, **events):
    pose = np.tile(POSE, (steps, traces, 1, 1))
    no = np.zeros((steps, 2), bool)
    return Recording(
        layout=LAYOUT,
        ctrl_dt=0.2,
        pose_w=pose,
        steering=np.zeros((steps, 2)),
        speed=np.tile([1.0, -1.0], (steps, 1)),
        goal=np.tile(GOAL, (steps, 1)),
        parked_pose=np.tile(PARKED, (steps, traces, 1, 1)),
        **{"active": ~no, "parked": no, "crashed": no, "timed_out": no} | events,
        step=np.tile(np.arange(1, steps + 1)[:, None], (1, 2)),
    )


def test_videos_play_in_real_time(renderer, tmp_path):
    import imageio_ffmpeg

    story = recording()
    assert frames_per_second(story) == pytest.approx(20.0)
    firsts = [frame_indices(story, fps)[0][0] for fps in (60, 20, 10, 5)]
    assert firsts == [0, 0, 1, 3]
    # A video has a frame, however short and slow it is.
    assert frame_indices(story, 1e-3)[0] == [num_frames(story) - 1]
    path = tmp_path / "a.mp4"
    pictures = (draw_frame(story, renderer, k) for k in range(12))
    assert write_video(path, pictures, 20.0) == 12
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert meta["size"] == (640, 360)
    assert meta["fps"] == pytest.approx(20.0)
    assert sum(1 for _ in reader) == 12
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]


def test_a_video_that_fails_leaves_nothing(tmp_path):
    def pictures(error=None):
        yield np.zeros((63, 65, 3), np.uint8)  # odd sizes become even
        if error is not None:
            raise error

    path = tmp_path / "a.mp4"
    for error in (RuntimeError("no more"), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            write_video(path, pictures(error), 10.0)
    with pytest.raises(OSError, match="at 1e-12 frames per second"):
        write_video(path, pictures(), 1e-12)
    assert list(tmp_path.iterdir()) == []
    assert write_video(path, pictures(), 10.0) == 1


def test_a_gif_plays_in_real_time_and_loops(renderer, tmp_path):
    from PIL import Image, ImageSequence

    story = recording()
    path = tmp_path / "a.gif"
    pictures = [draw_frame(story, renderer, k) for k in range(4)]
    assert write_video(path, iter(pictures), 10.0) == 4
    with Image.open(path) as gif:
        assert gif.size == (640, 360)
        assert gif.info["loop"] == 0
    # Equal frames are merged, and last longer.
    with Image.open(path) as gif:
        lasts = [f.info["duration"] for f in ImageSequence.Iterator(gif)]
    assert sum(lasts) == 4 * 100
    with pytest.raises(ValueError, match=r"\.mp4 or \.gif"):
        write_video(tmp_path / "a.avi", iter(pictures), 10.0)


def test_a_split_frame_is_two_views_side_by_side():
    stage = Stage(LAYOUT, COMPACT, 2, 2)
    with contextlib.closing(LotRenderer(stage, "split:1", (640, 360))) as made:
        frame = draw_frame(recording(), made, 0)
        assert frame.shape == (360, 640, 3)
        # The left view shows the whole lot although it is narrower than high.
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            corner = np.append(np.asarray(LAYOUT.extent) * (x, y), 0.0)
            px, py = made.project(corner, "topdown")
            assert 0 <= px <= 320
            assert 0 <= py <= 360
    right = frame[:, 320:].astype(int)
    assert np.abs(right - frame[:, :320]).mean() > 20


def test_a_renderer_draws_another_lot_as_a_new_one_does():
    # With arrows on its lanes the second has one mesh more, and it is longer.
    lots = [LAYOUT, jax.device_get(layout_config("street").generate(jax.random.key(0)))]
    what, new = seen(goal=GOAL[:1].repeat(2)), []
    stages = [Stage(layout, COMPACT, 2, 2) for layout in lots]
    for stage in stages:
        with contextlib.closing(LotRenderer(stage, "topdown", (640, 360))) as made:
            made.place(what)
            new.append(made.draw(what, "topdown"))
    assert (new[0] != new[1]).any(axis=-1).mean() > 0.1
    with contextlib.closing(LotRenderer(stages[0], "topdown", (640, 360))) as made:
        for lot in (0, 1, 0):
            made.show_lot(stages[lot])
            np.testing.assert_array_equal(made.draw(what, "topdown"), new[lot])


def test_snapshots_tell_states_tallies_and_flashes():
    parked = np.zeros((12, 2), bool)
    parked[1, 0] = True  # agent 0 parks in the second step
    active = np.ones((12, 2), bool)
    active[2:, 0] = False
    story = recording(steps=12, parked=parked, active=active)
    before = snapshot(story, 6)  # within the second step
    assert before.state == ("drives", "reverses")
    assert before.tally == {"parked": 0, "crashed": 0, "timed_out": 0}
    assert before.flashes == ()
    at = snapshot(story, 7)  # its end
    assert at.seconds == pytest.approx(0.4)
    assert at.tally["parked"] == 1
    (flash,) = at.flashes
    assert (flash.agent, flash.outcome, flash.age) == (0, "parked", 0.0)
    np.testing.assert_array_equal(flash.pose_w, POSE[0])
    later = snapshot(story, 7 + round(FLASH_SECONDS * frames_per_second(story)) - 1)
    assert 0.9 < later.flashes[0].age < 1.0
    gone = snapshot(story, 47)
    assert gone.flashes == ()
    assert gone.state == ("parked", "reverses")
    assert gone.tally["parked"] == 1


def test_an_agent_that_explores_has_no_goal_to_be_drawn(renderer):
    story = dataclasses.replace(
        recording(),
        speed=np.tile([1.0, 0.0], (3, 1)),
        goal=np.tile([GOAL[0], NO_BAY], (3, 1)),
        tracked_bays=np.tile([[5, 7], [NO_BAY, 3]], (3, 1, 1)),
    )
    what = snapshot(story, 0)
    assert what.state == ("drives", "stands, explores")
    np.testing.assert_array_equal(what.goal_pose, [BAYS[GOAL[0]], [np.nan] * 3])
    assert np.isnan(what.goal_size[1]).all()
    tracked = [[BAYS[5, :2], BAYS[7, :2]], [[np.nan] * 2, BAYS[3, :2]]]
    np.testing.assert_array_equal(what.tracked_bay_xy, tracked)
    renderer.place(what)
    frame = draw_labels(renderer.draw(what, "topdown"), renderer, what, "topdown")
    # The bay that would be its goal is as any other.
    goal = draw(renderer, goal=GOAL)
    x, y, yaw = BAYS[GOAL[1]]
    spot = (x + 0.9 * np.cos(yaw + 1.2), y + 0.9 * np.sin(yaw + 1.2), 0.0)
    pixels = [patch(picture, project(renderer, spot)) for picture in (frame, goal)]
    apart = [hue_distance(pixel, agent_colour(1)) for pixel in pixels]
    assert apart[1] < 15
    assert apart[0] > apart[1] + 5


GL = {
    "": "apt install libegl1",
    "junk": "must be egl, osmesa or glfw",
    "osmesa": "libosmesa6",
    "glfw": "no display",
    "GLX": "no display",
    "off": "turns pictures off",
}


@pytest.mark.parametrize("wanted", GL)
def test_an_opengl_that_cannot_work_is_told_what_it_lacks(wanted, monkeypatch):
    monkeypatch.setattr(gl, "_LIBRARIES", {"egl": "libnone.so", "osmesa": "libno.so"})
    monkeypatch.setattr(gl.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", wanted)
    if wanted in ("junk", "osmesa"):  # MuJoCo cannot be imported
        with pytest.raises(ValueError, match=GL[wanted]):
            gl.check_gl()
    else:  # a command can do without pictures
        gl.check_gl()
    if wanted != "junk":
        assert GL[wanted] in gl.choose_gl()
    if not wanted:  # MuJoCo must still import, for training without them
        assert "MUJOCO_GL" not in os.environ

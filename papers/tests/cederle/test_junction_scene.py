"""The junction in MuJoCo: what is seen from above, what opens, videos of drives."""

import dataclasses
import functools

import imageio_ffmpeg
import jax
import jax.numpy as jnp
import junctions
import mujoco
import numpy as np
import pytest
from helpers.scenes import try_out

from carpark_mj.geometry import box_corners
from carpark_mj.scene.parts import HULL_GROUP
from carpark_mj.vehicle import preset
from carpark_papers.cederle import video
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.junction import RasterConfig
from carpark_papers.cederle.junction.observations import (
    ASPHALT,
    GRASS,
    OTHER_CAR,
    OWN_CAR,
    PAINT,
    draw,
)
from carpark_papers.cederle.junction.rules import KEEP_LANE, SLOW_DOWN
from carpark_papers.cederle.junction.scene import drivable_junction
from carpark_papers.cederle.scene import JunctionSceneConfig, main
from carpark_papers.cederle.training.evaluations import record, write_video
from carpark_papers.cederle.video import JunctionStage

ENV = junctions.env(scenario="3av-hd", cars="bicycle")
POSES = [[7.0, 1.65, np.pi], [1.65, -16.0, np.pi / 2], [-9.0, -1.65, 0.0]]
TURNED = [[0.5, 0.2, -2.2], [1.65, -14.0, 1.5], [-9.0, -1.5, 0.1]]
HUMAN = [1.2, -4.0, 1.8]
FINER = 5  # pixels of the picture for one of the image


@functools.cache
def stage():
    return JunctionStage(preset("city"), 4)


def seen_from_above(state, agent):
    """The scene about a car, heading up, in the greys of the image.

    Cars are shown as the hulls with which they collide. Arrows are not in the image.
    """
    place, config = stage(), RasterConfig()
    place.snapshot(state)
    x, y, yaw = np.asarray(state.motion.pose_w[agent], float)
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.lookat[:] = x, y, 0.0
    camera.distance, camera.elevation = 60.0, -90.0
    camera.azimuth = np.degrees(yaw)
    camera.orthographic = 1
    place.model.vis.global_.fovy = config.extent
    option = mujoco.MjvOption()
    option.geomgroup[:] = 0
    option.geomgroup[[0, 1, HULL_GROUP]] = 1
    side = config.pixels * FINER
    with mujoco.Renderer(place.model, side, side) as renderer:
        renderer.enable_segmentation_rendering()
        renderer.update_scene(place.data, camera, option)
        found = renderer.render()[..., 0]
    levels = np.array(
        [_level(place.model.geom(g).name, agent) for g in range(place.model.ngeom)]
    )
    picture = np.where(found < 0, GRASS, levels[found])
    return picture.reshape(config.pixels, FINER, -1, FINER).mean(axis=(1, 3))


def _level(geom, agent):
    if geom == f"agent{agent}/hull":
        return OWN_CAR
    if geom.endswith("hull"):
        return OTHER_CAR
    if geom.startswith("line"):
        return PAINT
    return ASPHALT if geom == "ground" or "arrow" in geom else GRASS


@pytest.mark.parametrize("poses", [POSES, TURNED], ids=["along", "turned"])
def test_the_image_is_what_mujoco_sees_from_above(poses):
    state = junctions.with_poses(junctions.begin(ENV), [*poses, HUMAN])
    image = np.asarray(jax.jit(draw, static_argnums=0)(RasterConfig(), state), float)
    for agent in range(3):
        error = np.abs(image[agent] - seen_from_above(state, agent))
        assert error.mean() < 0.3  # of 255; measured 0.2 and at most 14
        assert error.max() < 25.0
    assert len(np.unique(image)) > 20


def test_the_scene_shows_cars_in_place_and_hides_those_that_left():
    state = junctions.with_poses(junctions.begin(ENV), [*TURNED, HUMAN])
    state = state.replace(present=np.array([True, True, True, False]))
    place = stage()
    place.snapshot(state)
    corners = np.asarray(box_corners(state.motion.pose_w, state.motion.size))
    for k in range(3):
        hull = place.data.geom(f"agent{k}/hull")
        np.testing.assert_allclose(hull.xpos[:2], corners[k].mean(axis=0), atol=1e-4)
    assert place.data.geom("agent3/hull").xpos[0] < -400


def test_a_scenario_opens_in_any_viewer_and_its_cars_drive(tmp_path):
    path = tmp_path / "junction.xml"
    main(JunctionSceneConfig(out=str(path), scenario="2av-hd"))
    text = path.read_text()
    assert "A road junction with 3 cars to drive" in text
    assert "file=" not in text
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.nu == 9
    assert model.geom("line0").size[0] > 10.0
    cameras = {model.camera(k).name for k in range(model.ncam)}
    assert {"topdown", "overview", "agent2/chase", "agent2/driver"} <= cameras
    spec = drivable_junction(preset("city"), np.array([[20.0, 1.65, np.pi]]))
    assert try_out(spec, 0.2) == []


CONFIG = DQNConfig(scenario="2av-hd", video_episodes=2, eval_jitter=0.0)


def act(observation):
    """The one from the east stands; the one from the west drives."""
    return jnp.tile(jnp.array([SLOW_DOWN, KEEP_LANE]), (len(observation), 1))


@pytest.fixture(scope="module")
def drives():
    return record(CONFIG, act)


def test_episodes_are_recorded_till_all_agents_are_done(drives):
    assert len(drives) == 2
    for drive in drives:
        assert len(drive.states) == len(drive.actions) == len(drive.ended)
        assert drive.states[-2].active.any()
        assert drive.states[0].motion.pose_w.shape == (3, 3)
        np.testing.assert_array_equal(drive.actions[5], [SLOW_DOWN, KEEP_LANE])


def test_below_every_car_stands_what_it_intends_or_how_it_ended(
    drives, tmp_path, monkeypatch
):
    seen = []

    def labels(frame, renderer, shown, camera):
        seen.append(shown)
        return frame

    monkeypatch.setattr(video, "draw_labels", labels)
    monkeypatch.setattr(video, "SIZE", (64, 64))
    path = video.write_drives(tmp_path / "video.mp4", CONFIG.junction, drives[:1])
    frames = 2 * len(drives[0].states)  # two traced instants of a step
    assert len(seen) == frames
    assert seen[19].seconds == pytest.approx(1.0)
    east, west, human = seen[10].state
    assert east.startswith("east: slow down, ")
    assert west.startswith("west: keep lane, ")
    assert human.startswith("human: keep lane, ")
    # One stands until its time is up; the other meets the human-driven car or arrives.
    ends = [text.split(": ")[1].split(",")[0] for text in seen[-1].state[:2]]
    crashed = bool(drives[0].ended[-1][1, 0])
    assert ends == ["timed out", "crashed" if crashed else "arrived"]
    assert seen[-1].tally == {"crashed": crashed}
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert count == frames + 20  # a second more
    assert seconds == pytest.approx(count / 20)


def test_cars_are_named_by_missions_whichever_agents_have_them(
    drives, tmp_path, monkeypatch
):
    seen = []
    monkeypatch.setattr(
        video, "draw_labels", lambda frame, _, shown, *__: seen.append(shown)
    )
    monkeypatch.setattr(video, "draw_status", lambda *_: np.zeros((64, 64, 3)))
    monkeypatch.setattr(video, "write_video", lambda _, frames, *__: [*frames])
    monkeypatch.setattr(video, "SIZE", (64, 64))
    first = drives[0].states[0]
    task = dataclasses.replace(first.task, order=np.array([1, 0, 2]))
    dealt = dataclasses.replace(
        drives[0],
        states=[dataclasses.replace(first, task=task)],
        actions=drives[0].actions[:1],
    )
    video.write_drives(tmp_path / "video.mp4", CONFIG.junction, [dealt])
    names = [text.split(":")[0] for text in seen[0].state]
    assert names == ["west", "east", "human"]


def test_there_is_no_video_where_none_is_wanted(tmp_path):
    write_video(tmp_path, dataclasses.replace(CONFIG, video_episodes=0), act)
    assert not [*tmp_path.iterdir()]

"""The MuJoCo scene: what it shows from above is the image, and it opens and drives."""

import functools

import jax
import junctions
import mujoco
import numpy as np
import pytest

from carpark_mj.geometry import box_corners
from carpark_mj.scene.build import try_out
from carpark_mj.scene.parts import HULL_GROUP
from carpark_mj.vehicle import preset
from carpark_papers.cederle.junction import RasterConfig
from carpark_papers.cederle.junction.observations import (
    ASPHALT,
    GRASS,
    OTHER_CAR,
    OWN_CAR,
    PAINT,
    draw,
)
from carpark_papers.cederle.junction.scene import drivable_junction
from carpark_papers.cederle.scene import JunctionSceneConfig, main
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


def test_the_scene_has_its_cars_where_they_are_and_hides_those_that_have_left():
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


def test_impossible_scenes_are_one_sentence(tmp_path):
    out = str(tmp_path / "a.xml")
    with pytest.raises(ValueError, match="unknown scenario '5av'; choose from"):
        main(JunctionSceneConfig(out=out, scenario="5av"))

"""The scene of a lot: everything named, placed as the layout says, cameras that see."""

import mujoco
import numpy as np
import pytest

from carpark_mj.geometry.obstacles import Boxes, Discs, ObstacleKind
from carpark_mj.layouts import make_layout
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene.build import build_scene
from carpark_mj.vehicle import COMPACT

AGENTS, PARKED = 3, 4


@pytest.fixture(scope="module", params=["square", "square_compact"])
def layout(request):
    return make_layout(request.param)


@pytest.fixture(scope="module")
def model(layout):
    return build_scene(layout, COMPACT, AGENTS, (COMPACT,) * PARKED).compile()


def test_all_bodies_joints_cameras_and_lights_are_named(model):
    for kind, count in (
        (mujoco.mjtObj.mjOBJ_BODY, model.nbody),
        (mujoco.mjtObj.mjOBJ_JOINT, model.njnt),
        (mujoco.mjtObj.mjOBJ_CAMERA, model.ncam),
        (mujoco.mjtObj.mjOBJ_LIGHT, model.nlight),
        (mujoco.mjtObj.mjOBJ_ACTUATOR, model.nu),
    ):
        names = [mujoco.mj_id2name(model, kind, k) for k in range(count)]
        assert all(names), kind
        assert len(set(names)) == count


def test_the_cast_is_complete(model, layout):
    assert model.nq == 13 * AGENTS + 3 * PARKED
    cameras = {model.camera(k).name for k in range(model.ncam)}
    assert cameras == {
        "topdown",
        "overview",
        *(f"agent{k}/{seat}" for k in range(AGENTS) for seat in ("chase", "driver")),
    }
    walls = [k for k in range(model.ngeom) if model.geom(k).name.startswith("wall")]
    assert len(walls) == int(layout.wall_mask.sum())


def test_walls_and_bay_lines_lie_where_the_layout_says(model, layout):
    for wall in range(len(layout.wall_mask)):
        geom = model.geom(f"wall{wall}")
        np.testing.assert_allclose(geom.pos[:2], layout.wall_pose[wall, :2], atol=1e-5)
        np.testing.assert_allclose(2 * geom.size[:2], layout.wall_size[wall], atol=1e-5)
        assert geom.pos[2] - geom.size[2] == pytest.approx(0.0)
    for bay in range(layout.num_bays):
        left, right = (model.geom(f"bay{bay}/{side}").pos for side in ("left", "right"))
        np.testing.assert_allclose(
            (left + right)[:2] / 2, layout.bay_pose[bay, :2], atol=1e-5
        )
        width = np.linalg.norm(left - right)
        assert width == pytest.approx(float(layout.bay_size[bay, 1]), abs=1e-5)


def test_an_agent_s_car_has_the_vehicle_s_mass_and_looks_weigh_nothing(model):
    for k in range(AGENTS):
        body = model.body(f"agent{k}/car")
        assert model.body_subtreemass[body.id] == pytest.approx(COMPACT.mass)


@pytest.mark.parametrize("camera", ["topdown", "overview"])
def test_fixed_cameras_see_every_corner_of_the_lot(model, layout, camera):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    index = model.camera(camera).id
    axes = data.cam_xmat[index].reshape(3, 3)
    tangent = np.tan(np.radians(model.cam_fovy[index]) / 2)
    x, y = np.asarray(layout.extent)
    for corner in ((x, y), (-x, y), (x, -y), (-x, -y)):
        local = axes.T @ (np.array([*corner, 0.0]) - data.cam_xpos[index])
        assert local[2] < 0  # in front: cameras look along -z
        assert abs(local[1] / local[2]) < tangent
        assert abs(local[0] / local[2]) < tangent * 4 / 3  # fits a 4:3 frame


def test_the_scene_survives_a_round_trip_through_xml(layout):
    spec = build_scene(layout, COMPACT, 1, (COMPACT,))
    model = spec.compile()
    again = mujoco.MjModel.from_xml_string(spec.to_xml())
    assert (again.nbody, again.ngeom, again.nq) == (model.nbody, model.ngeom, model.nq)


def test_people_walk_on_two_legs_and_carts_stand_on_the_ground():
    xy = np.array([[0.0, 2.0], [3.0, 2.0]])
    person = ObstacleKind.PERSON
    size, there = np.array([0.3, 0.25]), np.array([True, False])

    def movers(way):
        moved = xy + np.array([way, 0.0])
        cart = Boxes(np.array([[0.0, -2.0, 0.5]]), np.array([[1.0, 0.6]]))
        return Discs(moved, size, mask=there, kind=person), cart

    stage = Stage(make_layout("square"), COMPACT, 1, 0, movers=movers(0.0))
    angles = []
    for way in np.arange(0.0, 1.4, 0.1):
        stage.place(np.zeros((1, 3)), np.zeros(1), np.zeros((0, 3)), None, movers(way))
        legs = [stage.data.body(f"mover0/leg{side}").xmat[2] for side in (0, 1)]
        assert legs[0] == pytest.approx(-legs[1], abs=1e-6)
        angles.append(legs[0])
        body = stage.data.body("mover0")
        np.testing.assert_allclose(
            body.xpos[:2], xy[0] + np.array([way, 0.0]), atol=1e-6
        )
    assert max(angles) > 0.3
    assert min(angles) < -0.3  # both legs have been in front
    assert stage.data.body("mover1").xpos[2] < -10.0  # absent
    assert stage.data.body("mover1/leg0").xpos[2] < -10.0
    wheel, box = mujoco.mjtGeom.mjGEOM_CYLINDER, stage.model.body("mover2").id
    low = [
        stage.data.geom_xpos[geom, 2] - stage.model.geom_size[geom, 0]
        for geom in np.flatnonzero(stage.model.geom_bodyid == box)
        if stage.model.geom_type[geom] == wheel
    ]
    np.testing.assert_allclose(low, np.zeros(4), atol=1e-6)

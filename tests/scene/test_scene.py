"""The MuJoCo scene of a lot and its cameras."""

import dataclasses
import functools
import math
from contextlib import closing

import mujoco
import numpy as np
import pytest
from helpers.instants import hue_distance, instant
from helpers.scenes import lot

from carpark_mj.geometry.obstacles import Boxes, Discs, ObstacleKind
from carpark_mj.layouts import make_layout
from carpark_mj.rendering.renderer import LotRenderer
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene import looks, parts
from carpark_mj.scene.build import build_scene
from carpark_mj.scene.camera_flags import LOT_CAMERAS
from carpark_mj.scene.cameras import frame_lot, view_yaw
from carpark_mj.scene.looks import ASPHALT, ZENITH, agent_colour
from carpark_mj.scene.parts import add_bay_numbers
from carpark_mj.vehicle import COMPACT, PRESETS

AGENTS, PARKED = 3, 4


@pytest.fixture(scope="module", params=["square", "square_compact"])
def layout(request):
    return make_layout(request.param)


@pytest.fixture(scope="module")
def model(layout):
    return build_scene(layout, COMPACT, AGENTS, (COMPACT,) * PARKED).compile()


def test_the_cast_is_complete_and_everything_is_named(model, layout):
    assert model.nq == 13 * AGENTS + 3 * PARKED
    cameras = {model.camera(k).name for k in range(model.ncam)}
    seats = {f"agent{k}/{s}" for k in range(AGENTS) for s in ("chase", "driver")}
    assert cameras == {*LOT_CAMERAS} | seats
    for name in LOT_CAMERAS:
        camera, (eye, quat) = model.camera(name), frame_lot(name, layout.extent, 4 / 3)
        np.testing.assert_allclose([*camera.pos, *camera.quat], [*eye, *quat])
    walls = [k for k in range(model.ngeom) if model.geom(k).name.startswith("wall")]
    assert len(walls) == int(layout.wall_mask.sum())
    for k in range(AGENTS):  # looks weigh nothing
        body = model.body(f"agent{k}/car")
        assert model.body_subtreemass[body.id] == pytest.approx(COMPACT.mass)
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


def test_walls_and_bay_lines_lie_where_the_layout_says(model, layout):
    for wall in range(len(layout.wall_mask)):
        geom = model.geom(f"wall{wall}")
        np.testing.assert_allclose(geom.pos[:2], layout.wall_pose[wall, :2], atol=1e-5)
        np.testing.assert_allclose(2 * geom.size[:2], layout.wall_size[wall], atol=1e-5)
        assert geom.pos[2] - geom.size[2] == pytest.approx(0.0)
    for bay in range(layout.num_bays):
        left, right = (model.geom(f"bay{bay}/{side}").pos for side in ("left", "right"))
        middle = (left + right)[:2] / 2
        np.testing.assert_allclose(middle, layout.bay_pose[bay, :2], atol=1e-5)
        width = np.linalg.norm(left - right)
        assert width == pytest.approx(float(layout.bay_size[bay, 1]), abs=1e-5)


def test_people_walk_on_two_legs_and_carts_stand_on_the_ground():
    xy, there = np.array([[0.0, 2.0], [3.0, 2.0]]), np.array([True, False])
    cart = Boxes(np.array([[0.0, -2.0, 0.5]]), np.array([[1.0, 0.6]]))

    def movers(way):
        size, kind = np.array([0.3, 0.25]), ObstacleKind.PERSON
        return Discs(xy + np.array([way, 0.0]), size, mask=there, kind=kind), cart

    stage = Stage(make_layout("square"), COMPACT, 1, 0, movers=movers(0.0))
    model, data, angles = stage.model, stage.data, []
    for way in np.arange(0.0, 1.4, 0.1):
        stage.place(instant(np.zeros(3), movers=movers(way)))
        angles.append(data.body("mover0/leg0").xmat[2])
        at = data.body("mover0").xpos[:2]
        np.testing.assert_allclose(at, xy[0] + np.array([way, 0.0]), atol=1e-6)
    assert max(angles) > 0.3
    assert min(angles) < -0.3  # both legs have been in front
    for absent in ("mover1", "mover1/leg0"):
        assert data.body(absent).xpos[2] < -10.0
    own = model.geom_bodyid == model.body("mover2").id
    wheels = own & (model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER)
    low = data.geom_xpos[wheels, 2] - model.geom_size[wheels, 0]
    np.testing.assert_allclose(low, np.zeros(4), atol=1e-6)


SPEED = 3.0  # m/s
# Linear stiffness m v^2 / x^2 of a car of 1.4 t that is crushed by 0.6 m at 15.6 m/s,
# the speed of the frontal barrier test of NCAP (Gabler and Hollowell, SAE 980908).
STIFFNESS = 1400.0 * (15.6 / 0.6) ** 2  # N/m
# Howard, Bomar and Bare, SAE 931842: at 2 to 5 mph, between cars.
RESTITUTION = 0.2, 0.4


@functools.cache
def crash_model(second):
    """A compact, and ahead of its nose another car or a wall, without gravity."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    looks.add_materials(spec)
    nose = COMPACT.length - COMPACT.rear_overhang
    parts.add_agents(spec, COMPACT, 1)
    if second == "wall":
        wall = lot([(0, 0, 0)], [(nose + 0.51, 0, 0)], wall_size=(1.0, 6.0))
        parts.add_walls(spec, wall)
    else:
        params = PRESETS[second]
        parts.add_agents(spec, params, 1, kind=1)
        spec.body("agent0/kind1/car").pos = [nose + params.rear_overhang + 0.01, 0, 0]
    return spec.compile()


def crash(second, dt):
    """Of the centres of gravity (n,) the velocities after, energy lost, peak force."""
    built = crash_model(second)
    built.opt.timestep = dt
    data = mujoco.MjData(built)
    cars = np.flatnonzero(built.body_parentid == 0)[1:]
    data.qvel[built.body_dofadr[cars[0]]] = SPEED
    peak, wrench = 0.0, np.zeros(6)
    for _ in range(round(0.3 / dt)):
        mujoco.mj_step(built, data)
        force = 0.0
        for k in range(data.ncon):
            mujoco.mj_contactForce(built, data, k, wrench)
            force += wrench[0]
        peak = max(peak, force)
    assert data.ncon == 0  # apart again
    mujoco.mj_energyVel(built, data)
    mujoco.mj_subtreeVel(built, data)
    lost = COMPACT.mass * SPEED**2 / 2 - data.energy[1]
    return data.subtree_linvel[cars, 0], lost, peak


@pytest.mark.parametrize("second", ["compact", "van"])
def test_cars_part_as_in_published_crashes_and_keep_their_momentum(second):
    after, lost, peak = crash(second, 1e-3)
    mass = np.array([COMPACT.mass, PRESETS[second].mass])
    assert mass @ after == pytest.approx(COMPACT.mass * SPEED, rel=1e-5)
    low, high = RESTITUTION
    restitution = (after[1] - after[0]) / SPEED
    assert low < restitution < high
    # What is lost is what such a restitution loses of the relative motion's energy.
    moved = 1.0 / (1.0 / mass).sum()
    expected = moved * SPEED**2 * (1.0 - restitution**2) / 2
    assert lost == pytest.approx(expected, rel=0.03)  # the cars pitch a little
    # Two springs in series: about 55 kN between two compacts.
    force = SPEED * math.sqrt(STIFFNESS / 2 * moved)
    assert peak == pytest.approx(force, rel=0.2)


def test_a_wall_is_hit_with_the_force_of_one_spring():
    after, _, peak = crash("wall", 1e-3)
    low, high = RESTITUTION
    assert low < -after[0] / SPEED < high
    assert peak == pytest.approx(SPEED * math.sqrt(STIFFNESS * COMPACT.mass), rel=0.1)


@pytest.mark.parametrize("dt", [0.002, 0.005, 0.01])
def test_the_time_step_of_training_makes_a_crash_no_harder(dt):
    """At 10 ms the first force finds cars 3 cm deep: a third more for an instant."""
    fine, *_ = crash("compact", 1e-3)
    after, _, peak = crash("compact", dt)
    np.testing.assert_allclose(after, fine, atol=0.1)
    assert peak < 1.4 * SPEED * math.sqrt(STIFFNESS * COMPACT.mass) / 2


# Cameras


LAYOUT = make_layout("square")
SEEN = instant((-6.0, 0.0, 0.0), layout=LAYOUT, goal=[3], active=np.zeros(1, bool))


def seen_from(pos, quat, fovy, points):
    """Where points (n, 3) are in the frame: x and y over half its height."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, quat)
    local = (points - pos) @ axes.reshape(3, 3)
    assert (local[:, 2] < 0).all()
    return local[:, :2] / -local[:, 2:] / np.tan(np.radians(fovy) / 2)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 4 / 3, 16 / 9])
@pytest.mark.parametrize("extent", [(21.0, 21.0), (38.0, 6.0), (9.0, 20.0)])
@pytest.mark.parametrize(("camera", "fovy"), [("topdown", 30.0), ("overview", 38.0)])
def test_the_lot_fills_the_frame_and_no_corner_is_cut(camera, fovy, extent, aspect):
    pos, quat = frame_lot(camera, np.array(extent), aspect)
    corners = np.array([(x, y, 0.0) for x in (-1, 1) for y in (-1, 1)]) * [*extent, 0]
    x, y = seen_from(pos, quat, fovy, corners).T
    assert np.abs(x).max() < aspect
    assert np.abs(y).max() < 1.0
    # At most the walls' thickness away from two opposite edges.
    assert max(np.abs(x).max() / aspect, np.abs(y).max()) > 0.8
    # The longer side lies along the frame's longer side.
    if extent[0] != extent[1] and aspect != 1.0:
        across = seen_from(pos, quat, fovy, np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
        long_across = abs(across[1, 0] - across[0, 0]) > 1e-3
        assert long_across == ((extent[0] > extent[1]) == (aspect > 1.0))


def has_hue(pixels, colour):
    """Which pixels have a colour's hue, however bright."""
    return hue_distance(pixels, colour) < 8


@pytest.fixture(scope="module")
def fleet():
    """Draws the view of an agent that drives a preset, one of all of them."""
    kinds = list(PRESETS.values())
    stage = Stage(LAYOUT, kinds[0], 1, 0, kinds)
    with closing(LotRenderer(stage, "driver:0", (1280, 720))) as renderer:

        def draw(name):
            kind = np.array([list(PRESETS).index(name)])
            seen = dataclasses.replace(SEEN, kind=kind)
            groups = renderer.model.geom_group.copy()
            renderer.place(seen)
            frame = renderer.draw(seen, "agent0/driver").astype(float)
            # Other cameras see the roof again.
            np.testing.assert_array_equal(renderer.model.geom_group, groups)
            return frame

        yield draw


@pytest.mark.parametrize("name", PRESETS)
def test_the_driver_sees_the_road_and_no_pillar_cuts_the_view(fleet, name):
    frame = fleet(name)
    bright = frame.sum(axis=-1) > 90  # the dashboard is nearly black

    def share(top, bottom, colour):
        """Of the middle third's pixels whose hue is a colour's."""
        middle = slice(top, bottom), slice(480, 800)
        return (has_hue(frame[middle], colour) & bright[middle]).mean()

    assert share(0, 240, ZENITH) > 0.9
    assert share(350, 456, ASPHALT) > 0.7
    assert share(420, 708, agent_colour(0)) > 0.1
    paint = has_hue(frame, agent_colour(0)) & bright
    paint[: len(paint) // 2] = False  # sky
    sunlit = frame.sum(axis=-1) > 0.7 * np.median(frame[paint].sum(axis=-1))
    assert sunlit[paint].mean() > 0.99
    # Below the edge of the bonnet a column shows nothing but the car.
    below = np.maximum.accumulate(paint, axis=0)
    assert (paint | ~bright)[below].mean() > 0.99


@pytest.mark.parametrize("name", ["square", "street_parallel"])
def test_bay_numbers_are_upright_for_the_cameras_of_the_lot(name):
    layout, spec = make_layout(name), mujoco.MjSpec()
    add_bay_numbers(spec, layout)
    right = view_yaw(np.asarray(layout.extent))
    turns = [2 * np.arctan2(geom.quat[3], geom.quat[0]) for geom in spec.geoms]
    assert len(turns) >= int(layout.bay_mask.sum())
    assert (np.cos(np.array(turns) - right) > -0.01).all()

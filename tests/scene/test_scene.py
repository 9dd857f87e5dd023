"""The scene of a lot: placed as its layout says; crashes as in published tests."""

import functools
import math

import mujoco
import numpy as np
import pytest
from helpers.instants import instant
from helpers.scenes import lot

from carpark_mj.geometry.obstacles import Boxes, Discs, ObstacleKind
from carpark_mj.layouts import make_layout
from carpark_mj.rendering.stage import Stage
from carpark_mj.scene import looks, parts
from carpark_mj.scene.build import build_scene
from carpark_mj.scene.camera_flags import LOT_CAMERAS
from carpark_mj.scene.cameras import frame_lot
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
        legs = [data.body(f"mover0/leg{side}").xmat[2] for side in (0, 1)]
        assert legs[0] == pytest.approx(-legs[1], abs=1e-6)
        angles.append(legs[0])
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

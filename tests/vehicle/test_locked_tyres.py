"""Parked cars slide as on four Coulomb wheels, whose friction turns with their slip."""

import functools
import math

import mujoco
import numpy as np
import pytest
from helpers.coulomb import slide

from carpark_mj.scene import looks, parts
from carpark_mj.vehicle import COMPACT, PRESETS
from carpark_mj.vehicle.parameters import GRAVITY

AXES = ("x", "y", "yaw")
VAN = PRESETS["van"]


@functools.cache
def parked(params):
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    looks.add_materials(spec)
    parts.add_parked_cars(spec, (params,))
    return spec.compile()


def moved(params, pose, rates, seconds, push=lambda t: (0.0, 0.0), downhill=0.0):
    """Pose and rates of the rear axle after a slide in MuJoCo."""
    model = parked(params)
    model.opt.gravity = -GRAVITY * np.array([downhill, 0.0, 1.0])
    data = mujoco.MjData(model)
    joints = [data.joint(f"parked0/{axis}") for axis in AXES]
    for joint, at, rate in zip(joints, pose, rates, strict=True):
        joint.qpos, joint.qvel = at, rate
    for k in range(round(seconds / model.opt.timestep)):
        data.qfrc_applied[:2] = push(k * model.opt.timestep)
        mujoco.mj_step(model, data)
    return np.array([(*j.qpos, *j.qvel) for j in joints]).T


@pytest.mark.parametrize("params", [COMPACT, VAN], ids=["compact", "van"])
def test_a_slide_ends_where_four_coulomb_wheels_end_it(params):
    rng = np.random.default_rng(3)
    pose = rng.uniform((-9, -9, -3), (9, 9, 3), (12, 3))
    rates = rng.uniform((-2.5, -2.5, -2), (2.5, 2.5, 2), (12, 3))
    expected = slide(params, pose, rates, 1.5)
    assert np.ptp((expected - pose)[:, 2]) > math.radians(30)
    for k in range(len(pose)):
        found, rest = moved(params, pose[k], rates[k], 1.5)
        assert np.abs(rest).max() < 1e-3
        assert np.linalg.norm((found - expected[k])[:2]) < 0.04
        assert abs(found[2] - expected[k, 2]) < math.radians(1.5)


def test_a_push_at_the_rear_axle_turns_the_car():
    """50 kN for 80 ms, as in a crash; joints with dry friction turned it by 1.9 deg."""

    def push(t):
        return 0.0, 50e3 * math.sin(math.pi * t / 0.08) if t < 0.08 else 0.0

    still = np.zeros(3)
    (expected,) = slide(COMPACT, still[None], still[None], 1.5, push)
    found, _ = moved(COMPACT, still, still, 1.5, push)
    assert math.degrees(expected[2]) == pytest.approx(-13.4, abs=0.1)
    np.testing.assert_allclose(found[:2], expected[:2], atol=0.02)
    assert found[2] == pytest.approx(expected[2], abs=math.radians(0.5))


def test_a_slide_is_as_long_in_every_direction():
    """And straight: v^2 / (2 mu g), along the velocity and without a turn."""
    length = 2.0**2 / (2 * COMPACT.tyre.friction * GRAVITY)
    for angle in np.linspace(0.0, math.pi / 2, 7):
        along = np.array([math.cos(angle), math.sin(angle)])
        found, _ = moved(COMPACT, (0.0, 0.0, 0.4), (*(2.0 * along), 0.0), 1.0)
        assert found[:2] @ along == pytest.approx(length, rel=0.05)
        assert abs(found[0] * along[1] - found[1] * along[0]) < 0.1 * length
        assert found[2] == pytest.approx(0.4, abs=1e-3)


def test_a_car_that_slides_hardly_resists_turning():
    """Friction that opposes the slide is not there for the turn: yaw decays slower."""

    def turned(sideways):
        return moved(COMPACT, np.zeros(3), (0.0, sideways, 0.5), 0.15)[1][2]

    assert turned(0.0) == pytest.approx(0.0, abs=1e-3)
    assert turned(3.0) > 0.2


@pytest.mark.parametrize(("share", "holds"), [(0.2, True), (0.95, True), (1.05, False)])
def test_a_parked_car_stands_on_a_slope_up_to_its_grip(share, holds):
    downhill = share * COMPACT.tyre.friction
    start, still = np.array([0.0, 0.0, 0.3]), np.zeros(3)
    begun, _ = moved(COMPACT, start, still, 0.5, downhill=downhill)
    found, rates = moved(COMPACT, start, still, 2.5, downhill=downhill)
    if holds:  # it creeps by less than 1 mm in a minute
        assert np.abs((found - begun) / 2.0).max() < 1e-3 / 60
    else:
        assert rates[0] < -0.2

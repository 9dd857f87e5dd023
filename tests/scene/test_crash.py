"""Crashes of hulls: conservation, restitution and force against published tests."""

import functools
import math

import mujoco
import numpy as np
import pytest
from helpers.scenes import lot

from carpark_mj.scene import looks, parts
from carpark_mj.vehicle import COMPACT, PRESETS

SPEED = 3.0  # m/s
# Linear stiffness m v^2 / x^2 of a car of 1.4 t that is crushed by 0.6 m at 15.6 m/s,
# the speed of the frontal barrier test of NCAP (Gabler and Hollowell, SAE 980908).
STIFFNESS = 1400.0 * (15.6 / 0.6) ** 2  # N/m
# Howard, Bomar and Bare, SAE 931842: at 2 to 5 mph, between cars.
RESTITUTION = 0.2, 0.4


@functools.cache
def model(second):
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
    built = model(second)
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

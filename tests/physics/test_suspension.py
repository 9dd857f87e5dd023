"""Contact wheels: their losses, and springs that leave a car as high as it was."""

import dataclasses
import math

import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from carpark_mj.config import SimConfig
from carpark_mj.layouts import make_layout
from carpark_mj.physics.coordinates import CarIndex
from carpark_mj.physics.mjx_step import (
    WheelIndex,
    axle_friction,
    contact_car_model,
    mjx,  # pyright: ignore[reportAttributeAccessIssue]
    with_wheels,
)
from carpark_mj.scene.build import drivable_scene
from carpark_mj.vehicle import COMPACT, PRESETS, make_vehicle
from carpark_mj.vehicle.mjcf import WHEELS
from vehicle_suite import formulas
from vehicle_suite.testbeds import contact_model

DT = 0.002
SPRUNG = SimConfig(sim_dt=0.004, tyres="contact", suspension=True)


def settled(params, suspension: bool, seconds: float = 4.0):
    model = contact_model(params, DT, suspension)
    data = mujoco.MjData(model)
    for _ in range(round(seconds / DT)):
        mujoco.mj_step(model, data)
    return model, data


@pytest.mark.parametrize("name", PRESETS)
def test_every_car_sits_as_high_and_as_level_as_without_springs(name):
    _, rigid = settled(PRESETS[name], False)
    _, sprung = settled(PRESETS[name], True)
    # A tenth of a millimetre, at both axles; pitch is twice the quaternion's y.
    apart = np.abs(sprung.qpos[[2, 5]] - rigid.qpos[[2, 5]])
    assert apart[0] < 1e-4
    assert 2 * apart[1] * PRESETS[name].wheelbase < 1e-4
    assert np.abs([sprung.joint(f"travel_{w}").qpos for w in WHEELS]).max() < 1e-4
    assert np.abs(sprung.qvel).max() < 1e-4


def test_a_spring_carries_its_corner_without_the_wheel():
    model = contact_model(COMPACT, DT, True)
    front, rear = formulas.axle_loads(COMPACT)
    wheel = COMPACT.wheel_mass * 9.81
    # In front a knuckle stands on the tyre beside the wheel.
    knuckle = COMPACT.knuckle_mass * 9.81
    expected = {"fl": front / 2 - wheel - knuckle, "rr": rear / 2 - wheel}
    for corner, force in expected.items():
        joint = model.joint(f"travel_{corner}")
        spring = -model.qpos_spring[joint.qposadr[0]] * joint.stiffness[0]
        assert spring == pytest.approx(force, rel=1e-9)


def test_a_balanced_car_that_is_kicked_upwards_heaves_as_a_damped_oscillator():
    # Sprung centre of gravity midway: heave alone, omega^2 = 4 k / m.
    knuckles = 2 * COMPACT.knuckle_mass * COMPACT.wheelbase / 2 / COMPACT.mass
    middle = COMPACT.wheelbase / 2 - knuckles
    car = dataclasses.replace(COMPACT, cg_to_front_axle=middle)
    sprung = car.mass - 4 * car.wheel_mass - 2 * car.knuckle_mass
    omega = math.sqrt(4 * car.tyre.vertical_stiffness / sprung)
    assert 1.3 < omega / (2 * math.pi) < 1.6  # Hz, a passenger car's
    model, data = settled(car, True)
    data.qvel[2] = kick = 0.05
    for wheel in WHEELS:
        data.joint(f"travel_{wheel}").qvel = -kick
    speed = []
    for _ in range(round(1.0 / DT)):
        mujoco.mj_step(model, data)
        speed.append(data.qvel[2])
    zeta = 4 * car.tyre.vertical_damping / sprung / (2 * omega)
    fast, time = omega * math.sqrt(1 - zeta**2), DT * np.arange(1, len(speed) + 1)
    wave = np.cos(fast * time) - zeta * omega / fast * np.sin(fast * time)
    expected = kick * np.exp(-zeta * omega * time) * wave
    assert np.abs(speed - expected).max() < 0.02 * kick


def test_friction_of_the_axles_is_rolling_resistance_and_brake():
    van = PRESETS["van"]
    loss = axle_friction(make_vehicle(van), jnp.array([10.0, 10.0, 0.0, 0.0]))
    rolling = formulas.rolling_resistance(van) * van.wheel_radius
    assert float(loss.sum()) == pytest.approx(rolling + 20.0, rel=1e-5)


def test_in_mjx_springs_and_friction_are_each_cars_own():
    """The van's data in the compact's model are the van's model."""
    van = PRESETS["van"]
    van = dataclasses.replace(van, tyre=dataclasses.replace(van.tyre, friction=0.7))
    model, expected = (contact_car_model(p, SPRUNG) for p in (COMPACT, van))
    vehicle = make_vehicle(van)
    changed = with_wheels(
        mjx.put_model(model), CarIndex(model), WheelIndex(model), vehicle, jnp.zeros(4)
    )
    springs = "jnt_stiffness", "dof_damping", "qpos_spring"
    for name in (*springs, "dof_frictionloss", "pair_friction"):
        found = np.asarray(getattr(changed, name))
        assert found == pytest.approx(getattr(expected, name), rel=1e-5), name
    assert not np.allclose(model.qpos_spring, expected.qpos_spring)
    assert not np.allclose(model.pair_friction, expected.pair_friction)


def test_an_exported_scene_has_springs_if_asked():
    layout = make_layout("square")
    poses = np.array([[0.0, 0.0, 0.0]])
    for sprung, count in ((False, 0), (True, 4)):
        spec = drivable_scene(layout, COMPACT, poses, np.zeros((0, 3)), sprung)
        model = spec.compile()
        slides = [model.joint(i).name for i in range(model.njnt)]
        assert sum(name.startswith("agent0/travel_") for name in slides) == count
        data = mujoco.MjData(model)
        for _ in range(500):
            mujoco.mj_step(model, data)
        assert np.abs(data.qpos[:2] - model.qpos0[:2]).max() < 1e-3
        assert abs(data.qpos[2] - model.qpos0[2]) < 2e-4

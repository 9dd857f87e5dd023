import dataclasses
import math

import jax
import mujoco
import numpy as np
import pytest

from carpark_mj.vehicle import COMPACT, VEHICLES, VehicleParameters, make_vehicle
from carpark_mj.vehicle.mjcf import WHEELS, car_model, chassis_inertial, hub_positions
from carpark_mj.vehicle.parameters import GRAVITY, LENGTHS, scaled

LIGHT = dataclasses.replace(
    COMPACT,
    mass=1000.0,
    wheelbase=2.4,
    cg_to_front_axle=1.1,
    yaw_inertia=1400.0,
    pitch_inertia=1350.0,
    roll_inertia=400.0,
    wheel_inertia=0.7,
    wheel_mass=14.0,
)
CARS = [pytest.param(COMPACT, id="compact"), pytest.param(LIGHT, id="light")]


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return car_model(COMPACT, sim_dt=0.01, gravity=(0.0, 0.0, -GRAVITY))


@pytest.mark.parametrize("params", CARS)
def test_chassis_and_wheels_recombine_to_the_whole_car(params: VehicleParameters):
    model = car_model(params, sim_dt=0.01, gravity=(0.0, 0.0, -GRAVITY))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    car = model.body("car").id
    mass = model.body_subtreemass[car]
    cg = data.subtree_com[car]
    # The free joint's block of the mass matrix is the composite inertia at the origin.
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    inertia = full[3:6, 3:6] - mass * (cg @ cg * np.eye(3) - np.outer(cg, cg))
    expected = [params.roll_inertia, params.pitch_inertia, params.yaw_inertia]
    # Measured below 1e-14 relative. Products of inertia are neglected by design.
    assert mass == pytest.approx(params.mass, rel=1e-9)
    assert cg == pytest.approx([params.cg_to_rear_axle, 0, params.cg_height], rel=1e-9)
    assert np.diag(inertia) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("params", CARS)
def test_what_is_left_for_the_chassis_is_a_possible_rigid_body(
    params: VehicleParameters,
):
    mass, com, inertia = chassis_inertial(params)
    assert 0 < mass < params.mass
    assert com[1] == pytest.approx(0.0, abs=1e-12)  # measured 0
    assert inertia.max() <= inertia.sum() - inertia.max()


@pytest.mark.parametrize("params", CARS)
def test_static_axle_loads_follow_from_the_lever_arms(params: VehicleParameters):
    load = np.asarray(make_vehicle(params).tyres.static_load)
    weight, base = params.mass * GRAVITY, params.wheelbase
    # float32 rounding, measured below 1e-7.
    front = weight * params.cg_to_rear_axle / base
    assert load[:2].sum() == pytest.approx(front, rel=1e-6)
    rear = weight * params.cg_to_front_axle / base
    assert load[2:].sum() == pytest.approx(rear, rel=1e-6)
    assert load[0] == load[1]
    assert load[2] == load[3]


CENTIMETRES = {
    field.name: 100.0 * getattr(COMPACT, field.name)
    for field in dataclasses.fields(COMPACT)
    if field.name in LENGTHS
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (CENTIMETRES, r"length must lie in \[1, 25\] m, not 425.5"),
        ({"mass": 1.38}, r"mass must .* kg, not 1.38"),
        ({"mass": 1.38e6}, r"mass must .* kg"),
        ({"max_speed": 300.0}, r"max_speed .* m/s, not 300"),
        ({"max_deceleration": 400.0}, r"max_deceleration .* m/s\^2, not 400"),
        ({"turning_circle": 1040.0}, r"turning_circle .* m, not 1040"),
    ],
)
def test_parameters_in_other_units_are_refused(change: dict, message: str):
    with pytest.raises(ValueError, match=message) as refusal:
        dataclasses.replace(COMPACT, **change)
    assert "\n" not in str(refusal.value)
    for params in VEHICLES.values():
        for factor in (0.5, 2.0):  # as far as parked cars are scaled
            scaled(params, factor)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"mass": 90.0}, id="lighter than its wheels"),
        pytest.param(
            {"yaw_inertia": 100.0, "roll_inertia": 2100.0},
            id="wheels alone have more yaw inertia",
        ),
        pytest.param({"yaw_inertia": 2690.0}, id="chassis flatter than a plate"),
    ],
)
def test_mass_properties_that_leave_no_chassis_are_refused(change: dict):
    with pytest.raises(ValueError, match="leave no possible chassis") as refusal:
        make_vehicle(dataclasses.replace(COMPACT, **change))
    assert "\n" not in str(refusal.value)


def test_every_body_joint_and_actuator_has_its_name(model: mujoco.MjModel):
    bodies = {model.body(i).name for i in range(model.nbody)}
    joints = {model.joint(i).name for i in range(model.njnt)}
    servos = {model.actuator(i).name for i in range(model.nu)}
    wheels = {f"wheel_{w}" for w in WHEELS}
    assert bodies == {"world", "car", "knuckle_fl", "knuckle_fr"} | wheels
    assert joints == {"root", "steer_fl", "steer_fr"} | {f"spin_{w}" for w in WHEELS}
    assert servos == {"steer_fl", "steer_fr"}


def test_the_car_has_twelve_dofs_and_no_constraint_row(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    data.qpos[model.joint("steer_fl").qposadr] = 2.0  # far beyond any steering lock
    data.ctrl[:] = 2.0
    mujoco.mj_step(model, data)
    assert model.nv == 12
    assert not model.jnt_limited.any()
    assert data.nefc == 0
    assert data.ncon == 0


def test_wheels_stand_where_the_parameters_say(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hubs = np.array([data.body(f"wheel_{w}").xpos for w in WHEELS])
    assert hubs == pytest.approx(hub_positions(COMPACT), abs=1e-12)  # measured 0
    left, right = hubs[[0, 2]], hubs[[1, 3]]
    assert (left[:, 1] - right[:, 1]).tolist() == [COMPACT.track_width] * 2
    assert hubs[0, 0] - hubs[2, 0] == COMPACT.wheelbase


def test_turned_steering_points_the_wheels_to_the_left(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    data.qpos[model.joint("steer_fl").qposadr] = 0.3
    mujoco.mj_forward(model, data)
    forward = data.body("wheel_fl").xmat.reshape(3, 3)[:, 0]
    # Exact rotation by the joint angle, measured 1e-16.
    assert forward == pytest.approx([math.cos(0.3), math.sin(0.3), 0.0], abs=1e-12)


def test_vehicle_arrays_are_strongly_typed_float32():
    # A weakly typed first state would compile every step twice.
    for leaf in jax.tree.leaves(make_vehicle(COMPACT)):
        assert leaf.dtype == np.float32
        assert not leaf.weak_type


def test_vehicle_arrays_carry_the_mass_properties_of_the_compiled_model():
    model = car_model(LIGHT, sim_dt=0.01, gravity=(0.0, 0.0, -GRAVITY))
    vehicle = make_vehicle(LIGHT)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos"):
        expected = getattr(model, name)
        # float32 rounding.
        assert getattr(vehicle, name) == pytest.approx(expected, rel=1e-6, abs=1e-7)


def test_bristle_stiffness_times_relaxation_is_the_slip_stiffness():
    tyre = dataclasses.replace(COMPACT.tyre, cornering_stiffness=9.0, slip_stiffness=15)
    tyres = make_vehicle(dataclasses.replace(COMPACT, tyre=tyre)).tyres
    load = np.asarray(tyres.static_load)
    lateral = np.asarray(tyres.lateral_stiffness) * tyre.lateral_relaxation
    along = np.asarray(tyres.longitudinal_stiffness) * tyre.longitudinal_relaxation
    scrub = np.asarray(tyres.torsion_stiffness) * tyre.torsion_yield
    # float32 rounding.
    assert lateral == pytest.approx(9.0 * load, rel=1e-6)
    assert along == pytest.approx(15.0 * load, rel=1e-6)
    expected = 2 / 3 * tyre.friction * load * tyre.patch_radius
    assert scrub == pytest.approx(expected, rel=1e-6)

"""The vehicle's model and arrays, presets against published figures, ranges."""

import dataclasses
import functools
import math
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from helpers.cars import ROAD_CARS

from carpark_mj.benchmarking import count_equations
from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.layouts import make_layout
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.ego import CAR, RESPONSE
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.vehicle import VEHICLES, VehicleParameters, make_vehicle
from carpark_mj.vehicle.mjcf import WHEELS, car_model, chassis_inertial, hub_positions
from carpark_mj.vehicle.parameters import (
    GRAVITY,
    LENGTHS,
    kerb_to_kerb,
    scaled,
    steering_for_circle,
)
from carpark_mj.vehicle.presets import (
    COMPACT,
    RANGES,
    cars_in_range,
    cars_of,
    usual_width,
)
from carpark_mj.vehicle.vehicle import wheels_of
from vehicle_suite.formulas import axle_loads

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
CARS = [pytest.param(car, id=name) for name, car in {**ROAD_CARS, "-": LIGHT}.items()]


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
    # What is left for the chassis is a possible rigid body.
    mass, com, inertia = chassis_inertial(params)
    assert 0.8 * params.mass < mass < params.mass
    assert 0.0 < com[0] < params.wheelbase
    assert com[1] == pytest.approx(0.0, abs=1e-12)  # measured 0
    assert inertia.max() <= inertia.sum() - inertia.max()


@pytest.mark.parametrize("params", CARS)
def test_static_axle_loads_follow_from_the_lever_arms(params: VehicleParameters):
    load = np.asarray(make_vehicle(params).tyres.static_load)
    # float32 rounding, measured below 1e-7.
    assert load == pytest.approx(np.repeat(axle_loads(params), 2) / 2, rel=1e-6)
    assert load[0] == load[1]
    assert load[2] == load[3]


def test_parameters_in_other_units_are_refused():
    centimetres = {name: 100.0 * getattr(COMPACT, name) for name in LENGTHS}
    for change in (centimetres, {"mass": 1.38}, {"max_speed": 300.0}):
        with pytest.raises(ValueError, match=r"must lie in \[.*\]"):
            dataclasses.replace(COMPACT, **change)
    for params in VEHICLES.values():
        for factor in (0.5, 2.0):  # as far as parked cars are scaled
            scaled(params, factor)


@pytest.mark.parametrize(
    "change",
    [
        {"mass": 90.0},  # lighter than its wheels
        {"yaw_inertia": 100.0, "roll_inertia": 2100.0},  # less than the wheels have
        {"yaw_inertia": 2690.0},  # the chassis would be flatter than a plate
    ],
)
def test_mass_properties_that_leave_no_chassis_are_refused(change: dict):
    with pytest.raises(ValueError, match="leave no possible chassis"):
        make_vehicle(dataclasses.replace(COMPACT, **change))


def test_the_model_has_12_dofs_no_constraints_and_steers_left(model):
    data = mujoco.MjData(model)
    data.qpos[model.joint("steer_fl").qposadr] = 2.0  # far beyond any steering lock
    data.ctrl[:] = 2.0
    mujoco.mj_step(model, data)
    assert model.nv == 12
    assert not model.jnt_limited.any()
    assert data.nefc == data.ncon == 0
    data = mujoco.MjData(model)
    data.qpos[model.joint("steer_fl").qposadr] = 0.3
    mujoco.mj_forward(model, data)
    hubs = np.array([data.body(f"wheel_{w}").xpos for w in WHEELS])
    assert hubs == pytest.approx(hub_positions(COMPACT), abs=1e-12)  # measured 0
    forward = data.body("wheel_fl").xmat.reshape(3, 3)[:, 0]
    # Exact rotation by the joint angle, measured 1e-16.
    assert forward == pytest.approx([math.cos(0.3), math.sin(0.3), 0.0], abs=1e-12)


def test_wheels_stand_at_the_corners_in_fleets_of_any_shape():
    fleet = jax.tree.map(
        lambda x: jnp.tile(x, (2, 3, *[1] * x.ndim)), make_vehicle(COMPACT)
    )
    x, y = COMPACT.wheelbase, COMPACT.track_width / 2
    corners = [(x, y), (x, -y), (0.0, y), (0.0, -y)]
    assert hub_positions(COMPACT)[:, :2] == pytest.approx(np.array(corners))
    for wheel, corner in zip(wheels_of(fleet), corners, strict=True):
        assert {leaf.shape for leaf in jax.tree.leaves(wheel)} == {(2, 3)}
        assert wheel.hub[0][1, 2] == pytest.approx(corner[0], rel=1e-6)
        assert wheel.hub[1][1, 2] == pytest.approx(corner[1], rel=1e-6)


def test_vehicle_arrays_have_the_compiled_model_s_mass_properties():
    model = car_model(LIGHT, sim_dt=0.01, gravity=(0.0, 0.0, -GRAVITY))
    vehicle = make_vehicle(LIGHT)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_pos"):
        expected = getattr(model, name)
        # float32 rounding.
        assert getattr(vehicle, name) == pytest.approx(expected, rel=1e-6, abs=1e-7)
    # A weakly typed first state would compile every step twice.
    for leaf in jax.tree.leaves(vehicle):
        assert (leaf.dtype, leaf.weak_type) == (np.float32, False)


@pytest.mark.parametrize("params", CARS[:-1])
def test_turning_circle_and_steering_invert_each_other(params: VehicleParameters):
    shape = (params.wheelbase, params.track_width, params.tyre_width)
    circle = kerb_to_kerb(*shape, params.max_steering)
    assert circle == pytest.approx(params.turning_circle, rel=1e-12)
    # The outer front wheel's own triangle: sin d_o = L / (D/2 - w/2).
    tan = math.tan(params.max_steering)
    outer = math.atan(tan / (1 + params.track_width / (2 * params.wheelbase) * tan))
    by_wheel = 2 * (params.wheelbase / math.sin(outer) + params.tyre_width / 2)
    assert circle == pytest.approx(by_wheel, rel=1e-12)
    for steering in np.radians([5.0, 20.0, 50.0]):
        back = steering_for_circle(*shape, kerb_to_kerb(*shape, steering))
        assert back == pytest.approx(steering, rel=1e-9)


@pytest.mark.parametrize("params", CARS[:-1])
def test_inertias_and_springs_follow_the_rules_of_thumb(params: VehicleParameters):
    # openpilot: I_zz = 0.2346 m L^2 within 2 %; m a b agrees within 10 % (measured
    # 0.4 to 9 %); I_xx close to that of a block of the car's width and height.
    rule = 0.2346 * params.mass * params.wheelbase**2
    assert params.yaw_inertia == pytest.approx(rule, rel=0.02)
    levers = params.cg_to_front_axle * params.cg_to_rear_axle
    assert params.yaw_inertia == pytest.approx(params.mass * levers, rel=0.1)
    block = params.mass / 12 * (params.width**2 + params.height**2)
    assert 0.5 * block < params.roll_inertia < block
    # And springs and dampers those of passenger cars.
    stiffness = 4 * params.tyre.vertical_stiffness
    frequency = math.sqrt(stiffness / params.mass) / (2 * math.pi)
    damping = 4 * params.tyre.vertical_damping / 2 / math.sqrt(stiffness * params.mass)
    assert 1.2 <= frequency <= 1.5
    assert 0.25 <= damping <= 0.4


# Cars from a range


# Length, width, wheelbase and turning circle [m] of data sheets from end to end.
SHEETS = {
    "Smart fortwo": (2.695, 1.663, 1.873, 6.95),
    "Suzuki Alto": (3.395, 1.475, 2.460, 8.4),
    "VW ID.4": (4.584, 1.852, 2.771, 10.2),
    "Mercedes S-Class, long": (5.289, 1.954, 3.216, 10.9),
    "Ford Transit L3H2": (5.981, 2.059, 3.750, 13.3),
    "Mercedes Sprinter L3": (6.967, 2.020, 4.325, 15.3),
}


def numbers(cars, *names):
    return np.array([[getattr(car, name) for name in names] for car in cars])


def test_cars_cover_every_range_evenly():
    cars = cars_in_range(64)
    for name in ("length", "steering_lag", "steering_rate"):
        low, high = RANGES[name]
        share = (np.sort(numbers(cars, name)[:, 0]) - low) / (high - low)
        np.testing.assert_allclose(share, (np.arange(64) + 0.5) / 64, atol=1e-6)
    drive = numbers(cars, "front_drive")
    assert all(np.mean(drive == share) > 0.3 for share in (0.0, 0.5, 1.0))
    assert cars_in_range.__wrapped__(64) == cars


@pytest.mark.parametrize("name", SHEETS)
def test_the_ranges_hold_real_cars(name):
    length, width, wheelbase, circle = SHEETS[name]
    tyre = 0.14 + 0.013 * length
    share = {
        "length": length,
        "width": width - usual_width(length),
        "wheelbase": wheelbase / length,
        "lock": steering_for_circle(wheelbase, width - tyre - 0.06, tyre, circle),
    }
    for name, value in share.items():
        low, high = RANGES[name]
        assert low <= value <= high, name


@pytest.fixture(scope="module")
def vehicles():
    cars = [make_vehicle(car) for car in cars_in_range(256)]
    return jax.tree.map(lambda *x: np.stack(x), *cars)


def test_observed_numbers_stay_in_their_ranges(vehicles):
    sight: Any = SimpleNamespace(
        vehicle=vehicles, motion=SimpleNamespace(size=vehicles.size)
    )
    observed = []
    for part in (CAR, RESPONSE):
        values = part.fill(sight)
        for field in part.fields:
            value = np.asarray(values[field.name])
            assert value.shape == (256, field.size)
            assert (value >= field.low).all()
            assert (value <= field.high).all()
            assert np.ptp(value, axis=0).max() > 0.1
            assert (value < 2.0).all()  # nothing is clipped
            observed.append(value)
    # No two cars look alike.
    assert len(np.unique(np.concatenate(observed, axis=1), axis=0)) == 256


def test_more_cars_in_a_range_cost_no_more_in_a_program():
    layout, counts = make_layout("square"), []
    for number in (8, 64):
        kinds = FleetConfig(agents=(f"range:{number}",))
        sight = ContinuousObservation(own_car=True)
        fleet = Fleet(EnvConfig(fleet=kinds, observation=sight), COMPACT)
        assert len(fleet.agents) == number
        begin = functools.partial(fleet.start, layout)
        counts.append(count_equations(jax.make_jaxpr(begin)(jax.random.key(0))))
    assert counts[0] == counts[1]


@pytest.mark.parametrize("name", ["range:", "range:0", "range:2000", "range:-1"])
def test_an_impossible_number_of_cars_is_refused(name):
    with pytest.raises(ValueError, match="range"):
        cars_of(name)

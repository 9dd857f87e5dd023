"""The cars that come by name, against published figures and rules of thumb."""

import dataclasses
import math

import numpy as np
import pytest
from helpers.cars import ROAD_CARS

from carpark_mj.env import ParkingEnv
from carpark_mj.vehicle import COMPACT, PRESETS, VehicleParameters, make_vehicle
from carpark_mj.vehicle.mjcf import chassis_inertial
from carpark_mj.vehicle.parameters import GRAVITY, kerb_to_kerb, steering_for_circle

CARS = [pytest.param(params, id=name) for name, params in ROAD_CARS.items()]
# Bicycle angles at full lock, from shop manuals' and published circles by hand:
# d_o = asin(L / (D/2 - w/2)), cot d = cot d_o - T / 2L.
LOCKS = {
    "city": 35.5,
    "compact": 34.2,
    "sedan": 35.5,
    "sedan_fwd": 35.1,
    "suv": 33.5,
    "van": 35.5,
}


@pytest.mark.parametrize("name", PRESETS)
def test_full_lock_is_that_of_the_published_turning_circle(name: str):
    # One decimal is what the hand calculation was rounded to.
    assert math.degrees(PRESETS[name].max_steering) == pytest.approx(
        LOCKS[name], abs=0.06
    )


@pytest.mark.parametrize("params", CARS)
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


@pytest.mark.parametrize("params", CARS)
def test_preset_leaves_a_possible_chassis_and_strongly_typed_arrays(
    params: VehicleParameters,
):
    mass, com, _ = chassis_inertial(params)
    assert 0.8 * params.mass < mass < params.mass
    assert 0.0 < com[0] < params.wheelbase
    vehicle = make_vehicle(params)
    assert np.isfinite(vehicle.body_inertia).all()
    assert vehicle.tyres.static_load.sum() == pytest.approx(
        params.mass * GRAVITY, rel=1e-6
    )


@pytest.mark.parametrize("params", CARS)
def test_inertias_follow_the_rules_of_thumb(params: VehicleParameters):
    # openpilot: I_zz = 0.2346 m L^2 within 2 %; m a b agrees within 10 % (measured
    # 0.4 to 9 %); I_xx close to that of a block of the car's width and height.
    rule = 0.2346 * params.mass * params.wheelbase**2
    assert params.yaw_inertia == pytest.approx(rule, rel=0.02)
    levers = params.cg_to_front_axle * params.cg_to_rear_axle
    assert params.yaw_inertia == pytest.approx(params.mass * levers, rel=0.1)
    block = params.mass / 12 * (params.width**2 + params.height**2)
    assert 0.5 * block < params.roll_inertia < block


@pytest.mark.parametrize("params", CARS)
def test_ride_frequency_and_damping_are_those_of_passenger_cars(
    params: VehicleParameters,
):
    stiffness = 4 * params.tyre.vertical_stiffness
    frequency = math.sqrt(stiffness / params.mass) / (2 * math.pi)
    damping = 4 * params.tyre.vertical_damping / 2 / math.sqrt(stiffness * params.mass)
    assert 1.2 <= frequency <= 1.5
    assert 0.25 <= damping <= 0.4


def test_a_custom_car_takes_one_call_and_drives_in_the_environment():
    taxi = dataclasses.replace(
        COMPACT, length=4.4, wheelbase=2.7, mass=1500.0, turning_circle=11.2
    )
    env = ParkingEnv(vehicle=taxi)
    assert env.vehicle is taxi
    assert ParkingEnv().vehicle is COMPACT

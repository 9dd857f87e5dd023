"""Cars from a range: plausible, evenly drawn, and rows of a fleet like presets."""

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from carpark_mj.benchmarking import count_equations
from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts.lot import LotConfig
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.ego import CAR, RESPONSE
from carpark_mj.vehicle import make_vehicle
from carpark_mj.vehicle.parameters import steering_for_circle
from carpark_mj.vehicle.range import RANGES, cars_in_range, cars_of, usual_width

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
    length, lag, rate = numbers(cars, "length", "steering_lag", "steering_rate").T
    for name, drawn in (
        ("length", length),
        ("steering_lag", lag),
        ("steering_rate", rate),
    ):
        low, high = RANGES[name]
        share = (np.sort(drawn) - low) / (high - low)
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


ROOMY = LotConfig(
    car=DesignCar(length=7.0, width=2.1, wheelbase=4.3, rear_overhang=1.6),
    bay_length=(7.5, 8.0),
    bay_width=(2.6, 3.2),
    cross_aisle=(9.0, 10.0),
    extra_aisle=(6.0, 7.0),
)


def roomy(number):
    return ParkingEnv(
        EnvConfig(
            layout=ROOMY,
            physics="bicycle",
            num_agents=2,
            num_parked_cars=4,
            fleet=FleetConfig(agents=(f"range:{number}",)),
            observation=ContinuousObservation(own_car=True, own_response=True),
        )
    )


def test_more_cars_in_a_range_cost_no_more_in_a_program():
    few, many = roomy(8), roomy(64)
    assert len(many.fleet.agents) == 64
    key = jax.random.key(0)
    counts = [count_equations(jax.make_jaxpr(env.reset)(key)) for env in (few, many)]
    assert counts[0] == counts[1]


@pytest.mark.parametrize("name", ["range:", "range:0", "range:2000", "range:-1"])
def test_an_impossible_number_of_cars_is_refused(name):
    with pytest.raises(ValueError, match="range"):
        cars_of(name)

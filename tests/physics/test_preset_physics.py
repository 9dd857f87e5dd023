"""Every preset on the road, against formulas: pulling away, stopping, holding."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.cars import ROAD_CARS

from carpark_mj.config import SimConfig
from carpark_mj.vehicle import Vehicle, make_vehicle
from carpark_mj.vehicle.parameters import GRAVITY
from carpark_mj.vehicle.vehicle import SURFACES, with_grip, with_mass
from vehicle_suite.driver import Driver, drive

NAMES = list(ROAD_CARS)
VARIANTS = ("plain", "loaded", "wet", "ice")
CARS = [(name, variant) for name in NAMES for variant in VARIANTS]
GRADE = 0.2
BRAKE = 300  # the step at which the brake is pressed


def make(name: str, variant: str) -> Vehicle:
    # Fast enough for pitching, some 4 cm of a stop, to matter little.
    vehicle = make_vehicle(dataclasses.replace(ROAD_CARS[name], max_speed=9.0))
    if variant == "loaded":
        return with_mass(vehicle, 1.3 * vehicle.mass, vehicle.cg)
    grip = SURFACES.get(variant, SURFACES["dry"])  # pyright: ignore
    return with_grip(vehicle, grip / SURFACES["dry"])


def stack(vehicles: list[Vehicle]) -> Vehicle:
    return jax.tree.map(lambda *x: jnp.stack(x), *vehicles)


@pytest.fixture(scope="module")
def fleet() -> Vehicle:
    return stack([make(*car) for car in CARS])


@pytest.fixture(scope="module")
def run(fleet: Vehicle) -> dict:
    """Full throttle for 6 s, then full brake for 8 s; ways and speeds every 20 ms.

    The brake pedal is let go below 0.2 m/s, where it would soon reverse: the hold takes
    over.
    """
    pedals = np.zeros((BRAKE + 400, len(CARS), 2))
    pedals[..., 1] = np.where(np.arange(len(pedals)) < BRAKE, 1.0, -1.0)[:, None]
    driver = Driver(release=0.2, after=BRAKE)
    motion = drive(SimConfig(ctrl_dt=0.02), fleet, pedals, driver=driver)
    x, speed = np.float64(motion.pose_w)[..., 0], np.float64(motion.speed)
    return {car: (x[:, k], speed[:, k]) for k, car in enumerate(CARS)}


def numbers(name: str, variant: str) -> tuple[float, float, float]:
    """Mass [kg], mass with the wheels' inertia [kg], rolling resistance [N]."""
    params = ROAD_CARS[name]
    mass = params.mass * (1.3 if variant == "loaded" else 1.0)
    spinning = 4 * params.wheel_inertia / params.wheel_radius**2
    return mass, mass + spinning, params.tyre.rolling_resistance * mass * GRAVITY


@pytest.mark.parametrize("variant", ["plain", "loaded", "wet"])
@pytest.mark.parametrize("name", NAMES)
def test_full_throttle_accelerates_by_force_over_mass(run, name, variant):
    _, effective, rolling = numbers(name, variant)
    force = ROAD_CARS[name].mass * ROAD_CARS[name].max_acceleration
    _, speed = run[name, variant]
    measured = (speed[149] - speed[49]) / 2.0
    # Tyre slip; measured within 0.16 %.
    assert measured == pytest.approx((force - rolling) / effective, rel=0.003)


@pytest.mark.parametrize("variant", ["plain", "loaded"])
@pytest.mark.parametrize("name", NAMES)
def test_full_brake_stops_within_v_squared_over_2a(run, name, variant):
    _, effective, rolling = numbers(name, variant)
    force = ROAD_CARS[name].mass * ROAD_CARS[name].max_deceleration
    x, speed = run[name, variant]
    expected = speed[BRAKE - 1] ** 2 / 2 * effective / (force + rolling)
    # The body pitches forward, some 4 cm; measured -0.9 to -1.2 %.
    assert x[-1] - x[BRAKE - 1] == pytest.approx(expected, rel=0.015)


@pytest.mark.parametrize("name", NAMES)
def test_on_ice_wheels_lock_and_friction_stops_the_car(run, name):
    _, speed = run[name, "ice"]
    # The last second above 0.4 m/s: wheels that spun on the throttle are locked.
    end = BRAKE + np.argmax(speed[BRAKE:] < 0.4)
    measured = speed[end - 50] - speed[end]
    friction = SURFACES["ice"] * GRAVITY
    assert measured == pytest.approx(friction, rel=0.003)  # measured 0.1 %


@pytest.mark.parametrize("name", NAMES)
def test_every_car_comes_to_rest_and_stays(run, name):
    for variant in ("plain", "loaded", "wet"):
        x, speed = run[name, variant]
        assert abs(speed[-1]) < 1e-3
        assert abs(x[-1] - x[-25]) < 1e-4


def test_the_brake_holds_every_preset_on_a_slope_of_a_fifth(fleet):
    # Uphill, downhill and across; standing cars on dry ground, hold for 6 s.
    rows = [k for k, (_, variant) in enumerate(CARS) if variant == "plain"]
    yaws = np.repeat((0.0, np.pi, np.pi / 2, 0.7), len(rows))
    chosen = jax.tree.map(lambda x: x[np.tile(rows, 4)], fleet)
    sim = SimConfig(ctrl_dt=0.2, grade_x=GRADE)
    motion = drive(sim, chosen, np.zeros((30, len(yaws), 2)), yaw=yaws)
    xy = np.asarray(motion.pose_w)[..., :2]
    assert np.linalg.norm(xy[-1] - xy[15], axis=-1).max() < 1e-4  # m, once settled
    assert np.linalg.norm(xy[-1], axis=-1).max() < 0.1
    assert np.abs(motion.speed[-1]).max() < 1e-4

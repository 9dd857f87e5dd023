"""Standard tests: distances are those of the cited texts, whatever the car."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from carpark_mj import EnvConfig, ParkingEnv
from carpark_mj.geometry import box_corners
from carpark_mj.suite import standard_tests
from carpark_mj.suite.levels import find_level, pick_cases
from carpark_mj.suite.standard_tests import TESTS
from carpark_mj.vehicle import preset

CARS = ("compact", "city", "van")


def box(pose, size):
    corners = box_corners(np.float32(pose), np.float32(size))
    return shapely.Polygon(np.asarray(corners, float))


def scenarios(name, vehicle):
    return TESTS[name](vehicle, preset(vehicle))


def car_box(scenario):
    car = preset(scenario.vehicle)
    return box(scenario.start, (car.length, car.width))


@pytest.mark.parametrize("vehicle", CARS)
def test_slots_are_those_of_iso_16787(vehicle):
    car = preset(vehicle)
    # A quarter of the length, that of cars of 4 to 6 m; 0.2 m of depth, 1.2 m of width.
    gap = {"parallel": 0.25 * np.clip(car.length, 4.0, 6.0), "perpendicular": 1.2}
    for kind, made in scenarios("iso16787", vehicle):
        what, side = kind.split("_")[0], kind.split("_")[-1]
        layout = made.layout
        cars = [
            box(pose, (car.length, car.width))
            for pose in np.asarray(layout.parked_pose)[list(made.parked)]
        ]
        slot = box(layout.bay_pose[made.goal_bay], layout.bay_size[made.goal_bay])
        own = car.length if what == "parallel" else car.width
        assert cars[0].distance(cars[1]) == pytest.approx(own + gap[what], abs=1e-4)
        deep = car.width + 0.2 if what == "parallel" else car.length
        left, low, right, high = slot.bounds
        assert high - low == pytest.approx(deep, abs=1e-4)
        assert high == pytest.approx(cars[0].bounds[3], abs=1e-4)
        # The car has passed the slot, which lies on its side.
        x, y, yaw = made.start
        across = (slot.centroid.y - y) * math.cos(yaw) - (
            slot.centroid.x - x
        ) * math.sin(yaw)
        assert (across < 0.0) == (side == "right")
        ahead = (x - slot.centroid.x) * math.cos(yaw)
        assert ahead >= (right - left) / 2 + car.length / 2 - 1e-4
        assert min(car_box(made).distance(one) for one in cars) > 0.9
        kerb = box(layout.wall_pose[0], layout.wall_size[0])
        if "kerb" in kind:
            assert kerb.distance(cars[0]) == pytest.approx(0.2, abs=1e-4)
            assert kerb.bounds[3] == pytest.approx(low, abs=1e-4)
        else:
            assert kerb.distance(slot) > 5.0


@pytest.mark.parametrize("vehicle", CARS)
def test_persons_behind_are_those_of_ncap(vehicle):
    car = preset(vehicle)
    found = scenarios("ncap_rear", vehicle)
    kinds = [kind for kind, _ in found]
    assert kinds.count("moving_50") == 2
    assert {kind for kind in kinds if kind != "moving_50"} == {
        f"stationary_{share}" for share in (25, 50, 75)
    }
    for kind, made in found:
        (person,) = made.scripts
        assert car_box(made).bounds[0] == pytest.approx(10.0, abs=1e-4)
        paces = [min(pace / 3.6, car.max_reverse_speed) for pace in (4, 8)]
        assert -made.speed in paces
        if kind != "moving_50":
            share = 0.5 - person.start[1] / car.width
            assert share == pytest.approx(int(kind[-2:]) / 100)
            continue
        # The car keeps its speed: where does its rear meet the person?
        reached = (
            10.0 + car.length / 2 - math.sqrt(person.near**2 - person.start[1] ** 2)
        )
        begins = reached / -made.speed
        meets = 10.0 / -made.speed
        state, clock = person.init(jax.random.key(0), None), meets - begins
        met, later = (
            dataclasses.replace(state, clock=jnp.float32(t)).pose
            for t in (clock, clock + 1.0)
        )
        assert np.abs(met[:2]).max() < 0.02
        assert np.linalg.norm(later - met) == pytest.approx(5 / 3.6, abs=1e-3)
        assert not person.yields


@pytest.mark.parametrize("vehicle", CARS)
def test_objects_stand_in_the_field_of_r158(vehicle):
    car = preset(vehicle)
    for kind, made in scenarios("r158", vehicle):
        (thing,) = made.scripts
        disc = shapely.Point(thing.start[:2]).buffer(thing.size[0] / 2)
        own = car_box(made)
        behind = own.bounds[0] - disc.bounds[2]
        assert behind == pytest.approx(float(kind.split()[0]), abs=1e-3)
        assert abs(thing.start[1]) <= car.width / 2 + 1e-6
        assert thing.size == (0.3, 0.3)
        # The bay is beyond it, and free.
        bay = box(made.layout.bay_pose[0], made.layout.bay_size[0])
        assert bay.bounds[2] < disc.bounds[0]


@pytest.mark.parametrize("name", TESTS)
def test_levels_take_turns_and_another_car(name):
    level = find_level(name)
    cases = pick_cases(name, len(level.numbers))
    kinds = [kind for kind, _ in scenarios(name, "compact")]
    assert list(cases.kind[: len(kinds)]) == kinds
    first = [made.start for _, made in scenarios(name, "compact")]
    poses = np.asarray(cases.start.options.pose)[: len(kinds), 0]
    np.testing.assert_allclose(poses, first, atol=1e-5)
    for (_, made), rows in zip(
        scenarios(name, "compact"), np.asarray(cases.layouts.bay_pose), strict=False
    ):
        np.testing.assert_allclose(rows[0], made.layout.bay_pose[0], atol=1e-6)
    part = pick_cases(name, 2, 1)
    assert list(part.number) == [1, 2]
    other = find_level(f"{name}:van")
    assert other.vehicle == "van"
    assert other.sha256 != level.sha256
    assert standard_tests.REPEATED * len(kinds) == 120 or name != "iso16787"


@pytest.mark.parametrize("vehicle", CARS)
@pytest.mark.parametrize("name", TESTS)
def test_every_car_has_an_environment(name, vehicle):
    """Bays as large as the car, in float32, are large enough for it."""
    level = find_level(f"{name}:{vehicle}")
    env = ParkingEnv(level.env(EnvConfig(num_agents=1)))
    assert env.config.vehicle == vehicle


@pytest.mark.parametrize("level", ["scenario", "iso16788", "busy:x"])
def test_levels_of_files_need_a_path_standard_tests_a_name(level):
    with pytest.raises(ValueError, match=r"needs a file|unknown level"):
        find_level(level)

"""The stage shows of every agent the car that it drives, and parked cars as large."""

import numpy as np
import pytest
from helpers.instants import instant
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import make_layout
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.named import zero_policy
from carpark_mj.rendering.recording import record
from carpark_mj.rendering.stage import Stage
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.types import ParkedCars
from carpark_mj.vehicle import COMPACT, PRESETS
from carpark_mj.vehicle.parameters import scaled

NAMES = ("city", "van")
KINDS = [PRESETS[name] for name in NAMES]
POSE = np.array([[5.0, 3.0, 0.4], [-6.0, -4.0, 2.0]])
PARKED = np.array([[12.0, -2.0, 1.0], [-12.0, 6.0, -2.0]])
CARS = [scaled(PRESETS["suv"], 1.05), PRESETS["city"]]


@pytest.fixture(scope="module")
def stage():
    return Stage(make_layout("square"), COMPACT, 2, 2, KINDS, CARS)


def hull(stage, name):
    """Centre (3,), heading and length and width of a hull."""
    geom = stage.model.geom(f"{name}hull").id
    axis = stage.data.geom_xmat[geom].reshape(3, 3)[:2, 0]
    yaw = np.arctan2(axis[1], axis[0])
    return stage.data.geom_xpos[geom], yaw, 2 * stage.model.geom_size[geom, :2]


@pytest.mark.parametrize("driven", [(0, 1), (1, 1), (1, 0)])
def test_the_driven_car_stands_on_its_footprint(stage, driven):
    stage.place(instant(POSE, PARKED, kind=np.array(driven)))
    for agent, shown in enumerate(driven):
        for kind, infix in enumerate(("", "kind1/")):
            centre, yaw, size = hull(stage, f"agent{agent}/{infix}")
            car = KINDS[kind]
            np.testing.assert_allclose(size, (car.length, car.width), atol=1e-6)
            if kind == shown:
                np.testing.assert_allclose(centre[:2], POSE[agent, :2], atol=1e-6)
                assert yaw == pytest.approx(POSE[agent, 2])
            else:
                assert centre[2] < -10.0
        infix = "kind1/" if shown else ""
        assert stage.camera(f"agent{agent}/chase") == f"agent{agent}/{infix}chase"
    assert stage.camera("topdown") == "topdown"


def test_front_wheels_obey_the_driven_car_s_geometry(stage):
    turned = {"steering": np.array([0.5, 0.5]), "kind": np.array([0, 1])}
    stage.place(instant(POSE, PARKED, **turned))
    for prefix, params in (("agent0/", KINDS[0]), ("agent1/kind1/", KINDS[1])):
        angles = [stage.data.joint(f"{prefix}steer_{s}").qpos[0] for s in ("fl", "fr")]
        # Ackermann: cotangents differ by track over wheelbase.
        difference = 1 / np.tan(angles[1]) - 1 / np.tan(angles[0])
        assert difference == pytest.approx(params.track_width / params.wheelbase)


def test_parked_cars_stand_on_their_own_footprints(stage):
    stage.place(instant(POSE, PARKED))
    for k, params in enumerate(CARS):
        centre, yaw, size = hull(stage, f"parked{k}/")
        np.testing.assert_allclose(centre[:2], PARKED[k, :2], atol=1e-6)
        assert yaw == pytest.approx(PARKED[k, 2])
        np.testing.assert_allclose(size, (params.length, params.width))


@pytest.mark.parametrize("scale", [0.9, 1.0, 1.1])
def test_parked_cars_are_scaled_presets(scale):
    fleet = Fleet(EnvConfig(fleet=FleetConfig(parked_cars=tuple(PRESETS))), COMPACT)
    size = scale * np.float32([(p.length, p.width) for p in PRESETS.values()])
    kinds = np.arange(len(size))
    cars = ParkedCars(kinds, np.zeros((len(size), 3)), size, kind=kinds)
    for found, params in zip(
        fleet.parked_vehicles(cars), PRESETS.values(), strict=True
    ):
        assert found.front_drive == params.front_drive
        assert found.height == pytest.approx(scale * params.height, rel=1e-5)


def test_a_recording_knows_the_cars_there_are_and_no_others():
    config = EnvConfig(
        num_agents=1,
        num_parked_cars=6,
        occupancy=(0.05, 0.08),  # of 36 bays: 2
        fleet=FleetConfig(NAMES, parked_cars=("suv",)),
        observation=ContinuousObservation(own_car=True),
    )
    env = ParkingEnv(config, SlidePhysics())
    story = record(env, zero_policy(ActionSpec(2)), 2, seed=0)
    assert story.parked_pose.shape == (2, story.pose_w.shape[1], 2, 3)
    assert np.abs(story.parked_pose[..., :2]).max() < 30.0
    suv = PRESETS["suv"]
    assert story.parked_cars is not None
    np.testing.assert_allclose(story.parked_cars.size, [(suv.length, suv.width)] * 2)
    assert story.kind is not None
    assert story.kind.shape == (2, 1)
    assert story.kind[0, 0] in (0, 1)

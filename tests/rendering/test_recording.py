"""Recordings of drives, and the stage that shows their cars."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.instants import instant
from helpers.sliding import SlidePhysics
from jax.experimental.compilation_cache import compilation_cache

from carpark_mj.cameras import Heights, paint, see
from carpark_mj.cameras.rig import car_cameras
from carpark_mj.config import EnvConfig, FleetConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import evaluate
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.layouts import make_layout
from carpark_mj.observations import ContinuousObservation, make_fields
from carpark_mj.observations.fields import Tracked
from carpark_mj.policy.named import random_policy
from carpark_mj.policy.networks import (
    NetworkConfig,
    init_normalizer,
    make_networks,
    make_policy,
    network_inputs,
)
from carpark_mj.rendering import recording as record_module
from carpark_mj.rendering.recording import (
    num_frames,
    parked_trace,
    record,
    tracked_points,
)
from carpark_mj.rendering.stage import Stage
from carpark_mj.rendering.video import CarCameras
from carpark_mj.rendering.web import LiveLot
from carpark_mj.spawning.fleet import Fleet
from carpark_mj.types import NO_BAY, ParkedCars
from carpark_mj.vehicle import COMPACT, PRESETS
from carpark_mj.vehicle.parameters import scaled


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(EnvConfig(num_agents=2, num_parked_cars=4), SlidePhysics())


def test_the_length_of_the_stretches_makes_no_difference(env, monkeypatch):
    steps = 5  # two stretches and a half
    policy = random_policy(env.action_spec)
    once = record(env, policy, steps, seed=1)
    monkeypatch.setattr(record_module, "CHUNK", 2)
    again = record(env, policy, steps, seed=1)
    assert once.pose_w.shape[0] == steps
    for field in dataclasses.fields(once):
        parts = (getattr(story, field.name) for story in (again, once))
        for found, expected in zip(*map(jax.tree.leaves, parts), strict=True):
            np.testing.assert_array_equal(found, expected, field.name)


def test_the_cameras_of_a_car_see_the_state_that_was_recorded():
    config = EnvConfig(
        num_agents=2,
        num_parked_cars=4,
        observation=ContinuousObservation(own_car=True),
        fleet=FleetConfig(agents=("city", "van"), parked_cars=("van", "city")),
        movers=("cart",),
    )
    env, seed, size = ParkingEnv(config, SlidePhysics()), 3, (32, 24)
    action = jnp.array([[0.0, 1.0], [0.0, -1.0]])
    story = record(env, lambda observation, key: (action, {}), 2, seed)
    state, _ = jax.jit(lambda key: env.reset(key, "test"))(
        jax.random.split(evaluation_key(seed))[0]
    )
    for _ in range(2):
        state, _ = jax.jit(env.step)(state, action)
    rig = car_cameras("surround", size)
    assert rig is not None
    heights = Heights.of(env.fleet)
    pictures = jax.jit(lambda state: see(rig, state, heights))(state)
    for channel in ("colour", "depth"):
        cameras = CarCameras(env, story, rig, channel, size)
        frame = cameras.draw(num_frames(story) - 1)
        front, rear, left, right = np.asarray(paint(pictures, channel))[0].astype(int)
        rows = np.hstack([front, rear]), np.hstack([left, right])
        # Programs may round differently, at edges too.
        assert (np.abs(frame - np.vstack(rows)) <= 1).mean() > 0.995


class PushPhysics(SlidePhysics):
    """Agent 0 pushes parked car 0 along, always 30 m north of it."""

    def parked_poses(self, state, intended):
        north = state.pose_w[..., 0, :2] + jnp.array([0.0, 30.0])
        return intended.at[..., 0, :2].set(north)


def test_a_pushed_parked_car_is_drawn_where_it_is():
    env = ParkingEnv(EnvConfig(num_agents=1, num_parked_cars=4), PushPhysics())
    policy = random_policy(env.action_spec)
    story = record(env, policy, 4, seed=1)
    # From the second step on: before the first the car stands in its bay.
    apart = (story.parked_pose[:, :, 0] - story.pose_w[:, :, 0])[1:]
    np.testing.assert_allclose(apart[..., 0], 0.0, atol=1e-4)
    np.testing.assert_allclose(apart[..., 1], 30.0, atol=1e-4)
    live = LiveLot(env, policy, seed=1)
    for k in range(3 * live.traces):
        live.step()
        seen = live.snapshot()
        if k < live.traces:
            continue
        apart = seen.parked_pose[0] - seen.pose_w[0]
        np.testing.assert_allclose(apart[:2], (0.0, 30.0), atol=1e-4)
    # They did move.
    assert np.ptp(story.pose_w[:, :, 0, 0]) > 0.1


def test_a_parked_car_turns_the_short_way(env):
    state, _ = jax.jit(env.reset)(jax.random.key(0))
    parked = state.parked_cars
    pose = jnp.array([[0, 0, 3.1], [1, 0, 0], [2, 0, 0], [3, 0, 0]], jnp.float32)
    before = state.replace(parked_cars=parked.replace(pose_w=pose))
    pushed = pose.at[0, 2].set(-3.1).at[1, 0].set(9.0)
    bay = parked.bay.at[1].set(NO_BAY)
    after = state.replace(parked_cars=parked.replace(bay=bay, pose_w=pushed))
    trace = parked_trace(before, after, state.motion)
    turn = 2 * np.pi - 6.2
    np.testing.assert_allclose(trace[:, 0, 2], 3.1 + turn * np.arange(1, 5) / 4, 1e-5)
    np.testing.assert_array_equal(trace[:, 1:], np.tile(pose[1:], (4, 1, 1)))


@pytest.fixture
def programs(tmp_path):
    """Lists the programs compiled so far."""
    settings = {
        "jax_compilation_cache_dir": str(tmp_path),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
    yield lambda: {path.name for path in tmp_path.glob("*-cache")}
    for name, value in before.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()


@pytest.mark.parametrize(
    "drive",
    [lambda *args: record(*args, 2, 0), lambda *args: evaluate(*args, 2, 0)],
    ids=["record", "evaluate"],
)
def test_another_checkpoint_needs_no_other_program(env, drive, programs):
    config, fields = NetworkConfig((8,), (8,)), make_fields(env.config)
    networks = make_networks(config, fields, env.action_spec)
    normalizer = init_normalizer(network_inputs(config, fields))
    init = jax.jit(networks.policy_network.init)
    weights = [init(jax.random.key(seed)) for seed in (0, 1)]
    drive(env, make_policy(networks, normalizer, weights[0], True))
    compiled = programs()
    assert compiled
    drive(env, make_policy(networks, normalizer, weights[1], True))
    assert programs() == compiled


def links(what, tracked):
    """What is tracked, as (agent, (x, y))."""
    return [(agent, tuple(point)) for agent, point in tracked_points(what, tracked)]


def test_tracked_points_are_the_nearest_cars_of_each_agent():
    pose = np.array([[0.0, 0, 0], [3, 0, 0], [10, 0, 0]])
    parked = np.array([[0.0, 5, 0], [9, 5, 0]])
    what = instant(pose, parked)
    assert sorted(links(what, Tracked(1, 1))) == [
        (0, (0.0, 5.0)),
        (0, (3.0, 0.0)),
        (1, (0.0, 0.0)),
        (1, (0.0, 5.0)),
        (2, (3.0, 0.0)),
        (2, (9.0, 5.0)),
    ]
    assert links(what, Tracked()) == []
    # In one list the nearest is an agent for 0 and 1 and a parked car for 2.
    together = [(0, (3.0, 0.0)), (1, (0.0, 0.0)), (2, (9.0, 5.0))]
    assert links(what, Tracked(cars=1)) == together
    assert len(links(instant(pose), Tracked(5, 2))) == 6  # two others each, no parked


def test_tracked_bays_are_linked_and_empty_slots_are_not():
    none = [np.nan, np.nan]
    bays = np.array([[[1.0, 2.0], none], [none, none], [[3.0, 4.0], [5.0, 6.0]]])
    what = instant(np.zeros((3, 3)), tracked_bay_xy=bays)
    expected = [(0, (1.0, 2.0)), (2, (3.0, 4.0)), (2, (5.0, 6.0))]
    assert links(what, Tracked()) == expected


SUV = PRESETS["suv"]


@pytest.fixture(scope="module")
def small_env():
    config = EnvConfig(
        num_agents=4,
        min_agents=1,
        num_parked_cars=6,
        occupancy=(0.05, 0.08),  # of 36 bays: 2
        fleet=FleetConfig(parked_cars=("suv",)),
    )
    return ParkingEnv(config, SlidePhysics())


def test_absent_cars_are_not_recorded(small_env, monkeypatch):
    monkeypatch.setattr(record_module, "CHUNK", 2)
    counts = set()
    for seed in range(4):
        recording = record(small_env, random_policy(small_env.action_spec), 2, seed)
        count = recording.goal.shape[1]
        for name in ("steering", "speed", "active", "parked", "step"):
            assert getattr(recording, name).shape[1] == count
        assert recording.pose_w.shape[2] == count
        assert recording.parked_pose.shape[2] == 2
        sizes = recording.parked_cars.size
        np.testing.assert_allclose(sizes, [(SUV.length, SUV.width)] * 2)
        assert recording.active.all()
        for pose in (recording.pose_w, recording.parked_pose):
            assert np.abs(pose[..., :2]).max() < 30.0
        counts.add(count)
    assert len(counts) > 1


def test_a_live_lot_begins_as_the_video_with_its_seed(small_env):
    policy = random_policy(small_env.action_spec)
    for seed in range(2):
        lot = LiveLot(small_env, policy, seed)
        video = record(small_env, policy, 2, seed)
        goals = np.asarray(video.layout.bay_pose)[video.goal[0]]
        shown = lot.snapshot().goal_pose
        np.testing.assert_array_equal(shown, goals)
        lot.step()  # absent agents are not shown
        assert len(shown) == lot.stage.num_agents == video.goal.shape[1]
        assert np.abs(lot.snapshot().pose_w).max() < 100.0


# The stage


KINDS = [PRESETS["city"], PRESETS["van"]]
POSE = np.array([[5.0, 3.0, 0.4], [-6.0, -4.0, 2.0]])
PARKED = np.array([[12.0, -2.0, 1.0], [-12.0, 6.0, -2.0]])
CARS = [scaled(SUV, 1.05), PRESETS["city"]]


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
def test_cars_stand_on_their_footprints(stage, driven):
    stage.place(instant(POSE, PARKED, kind=np.array(driven)))
    for k, params in enumerate(CARS):
        centre, yaw, size = hull(stage, f"parked{k}/")
        np.testing.assert_allclose(centre[:2], PARKED[k, :2], atol=1e-6)
        assert yaw == pytest.approx(PARKED[k, 2])
        np.testing.assert_allclose(size, (params.length, params.width))
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


def test_parked_cars_are_scaled_presets():
    scale = 1.1
    fleet = Fleet(EnvConfig(fleet=FleetConfig(parked_cars=tuple(PRESETS))), COMPACT)
    size = scale * np.float32([(p.length, p.width) for p in PRESETS.values()])
    kinds = np.arange(len(size))
    cars = ParkedCars(kinds, np.zeros((len(size), 3)), size, kind=kinds)
    for found, params in zip(
        fleet.parked_vehicles(cars), PRESETS.values(), strict=True
    ):
        assert found.front_drive == params.front_drive
        assert found.height == pytest.approx(scale * params.height, rel=1e-5)

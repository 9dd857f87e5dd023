"""Pictures in observations: fields with a shape, dictionaries in Gymnasium."""

import dataclasses
import functools

import jax
import numpy as np
import pytest

from carpark_mj.cameras import Heights, see
from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.config import ENCODERS, EnvConfig, GoalConfig, RayConfig, RingConfig
from carpark_mj.observations import make_fields, observation_size
from carpark_mj.registry import environment
from carpark_mj.wrappers.gymnasium_env import ParkEnv

OBSERVATION = CameraObservation(
    1, 1, rings=RingConfig(), rays=RayConfig(), width=6, height=4
)
CONFIG = EnvConfig(
    layout="square",
    num_agents=1,
    num_parked_cars=2,
    physics="bicycle",
    observation=OBSERVATION,
)


@functools.cache
def env():
    return ParkEnv(config=CONFIG)


def test_pictures_are_what_the_cameras_see():
    observation, _ = env().reset(seed=3)
    batch = env()._batch
    state = jax.tree.map(lambda x: x[0], batch.state)
    pictures = see(OBSERVATION.cameras, state, Heights.of(batch.env.fleet))
    depth = pictures.depth[0] / OBSERVATION.cameras.reach
    np.testing.assert_allclose(observation["camera_depth"], depth, atol=1e-5)
    np.testing.assert_array_equal(observation["camera_seen"], pictures.seen[0])


def test_gymnasium_has_a_dictionary_of_the_vector_and_the_pictures():
    space = env().observation_space
    observation, _ = env().reset(seed=3)
    assert space.contains(observation)
    assert {name: box.shape for name, box in space.items()} == {
        "vector": (observation_size(CONFIG) - 2 * 4 * 4 * 6,),
        "camera_depth": (4, 4, 6),
        "camera_seen": (4, 4, 6),
    }
    env().action_space.seed(0)
    for _ in range(20):
        stepped, _, terminated, truncated, _ = env().step(env().action_space.sample())
        assert space.contains(stepped)
        if terminated or truncated:
            env().reset()


def test_a_goal_that_is_only_seen_is_in_no_number():
    seen = dataclasses.replace(OBSERVATION, goal="seen")
    told, untold = (
        {field.name for field in encoder.fields(CONFIG) if field.reveals_goal}
        for encoder in (OBSERVATION, seen)
    )
    assert untold == {"camera_seen"} < told
    with pytest.raises(ValueError, match="goal 'seen' needs fixed goals"):
        dataclasses.replace(CONFIG, observation=seen, goals=GoalConfig(dynamic=True))


def test_who_sees_is_told_of_no_other_car_and_no_wall():
    fields = make_fields(environment("sees"))
    assert not {field.group for field in fields} - {""}
    assert not {field.name for field in fields} & {"rays", "ultrasound"}
    assert not any(field.name.startswith("ring_") for field in fields)
    assert {"camera_depth", "camera_seen"} < {field.name for field in fields}


def test_it_is_chosen_by_name():
    assert ENCODERS["cameras"] is CameraObservation


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rig": "periscope"}, "unknown camera rig 'periscope'; choose from"),
        ({"width": 0}, "width must be at least 1"),
        ({"channels": ()}, "channels must be one or both"),
        ({"channels": ("depth", "depth")}, "channels must be one or both"),
        ({"reach": 0.0}, "reach must be positive"),
        ({"goal": "told"}, "unknown goal 'told'"),
        ({"goal": "seen", "channels": ("depth",)}, "goal 'seen' needs the channel"),
        ({"goal": "seen", "route": True}, "route tells where the goal is"),
        ({"goal": "seen", "lines": True}, "lines tells where the goal is"),
    ],
)
def test_impossible_pictures_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        CameraObservation(**settings)

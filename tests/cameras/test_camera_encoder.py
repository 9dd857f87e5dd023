"""Pictures in observations: fields with a shape, dictionaries in Gymnasium."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import POSES, SlidePhysics

import carpark_mj
from carpark_mj import ParkingEnv
from carpark_mj.cameras import Heights, Seen, see
from carpark_mj.cameras.encoder import CameraObservation
from carpark_mj.config import ENCODERS, EnvConfig, GoalConfig, RayConfig, RingConfig
from carpark_mj.observations import make_fields, observation_size
from carpark_mj.observations.fields import FAR
from carpark_mj.observations.sensors import observed
from carpark_mj.registry import environment
from carpark_mj.wrappers.gymnasium_env import ParkEnv, ParkVectorEnv

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


SHAPES = {
    "vector": (observation_size(CONFIG) - 2 * 4 * 4 * 6,),
    "camera_depth": (4, 4, 6),
    "camera_seen": (4, 4, 6),
}


@functools.cache
def env():
    return ParkEnv(config=CONFIG)


def test_pictures_are_what_the_cameras_see():
    observation, _ = env().reset(seed=3)
    batch = env()._batch
    state = jax.tree.map(lambda x: x[0], jax.device_get(batch.state))
    heights = Heights.of(batch.env.fleet)
    pictures = jax.jit(see, static_argnums=(0, 2))(OBSERVATION.cameras, state, heights)
    pictures = jax.device_get(pictures)
    depth = (observation["camera_depth"] / 255) ** 2 * OBSERVATION.cameras.reach
    # At most half a byte of the square root.
    near = np.sqrt(pictures.depth[0] * OBSERVATION.cameras.reach) / 255 + 1e-3
    assert (np.abs(depth - pictures.depth[0]) <= near).all()
    seen = np.round(observation["camera_seen"] * (max(Seen) / 255))
    np.testing.assert_array_equal(seen, pictures.seen[0])


def gymnasium_vector():
    envs = ParkVectorEnv(2, config=CONFIG)
    envs.reset(seed=3)
    return envs.step(np.zeros((2, 2)))[0], 1


def pettingzoo():
    pytest.importorskip("pettingzoo")
    agents = carpark_mj.parallel_env(config=CONFIG)
    observation = agents.reset(seed=3)[0]["agent_0"]
    assert agents.observation_space("agent_0").contains(observation)
    assert agents.state_space.contains(agents.state())
    assert agents.state().size == observation_size(CONFIG)
    observation = agents.step({"agent_0": np.zeros(2)})[0]["agent_0"]
    return observation, 0


def torchrl():
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    from carpark_mj.wrappers.torchrl import TorchRLParking

    lots = TorchRLParking(2, seed=3, config=CONFIG)
    check_env_specs(lots)
    lots.set_seed(3)
    tensors = lots.reset()
    tensors["agents", "action"] = (
        tensors["agents", "observation", "vector"][..., :2] * 0
    )
    seen = lots.step(tensors)["next", "agents", "observation"]
    return {name: seen[name].numpy() for name in seen.keys()}, 2  # noqa: SIM118


def jaxmarl():
    pytest.importorskip("jaxmarl")
    from carpark_mj.wrappers.jaxmarl import JaxMarlParking

    lot = JaxMarlParking(config=CONFIG)
    observation, state = lot.reset(jax.random.key(3))
    assert lot.observation_space("agent_0").contains(observation["agent_0"])
    action = {"agent_0": jnp.zeros(2)}
    return jax.jit(lot.step_env)(state.key, state, action)[0]["agent_0"], 0


@pytest.mark.parametrize("adapter", [gymnasium_vector, pettingzoo, torchrl, jaxmarl])
def test_all_adapters_give_the_same_pictures(adapter):
    env().reset(seed=3)
    expected = env().step(np.zeros(2, np.float32))[0]
    assert env().observation_space.contains(expected)
    observation, axes = adapter()
    assert {name: x.shape[axes:] for name, x in observation.items()} == SHAPES
    for name, array in expected.items():
        found = np.asarray(observation[name])[(0,) * axes]
        assert found.dtype == array.dtype
        # Programs may round differently.
        np.testing.assert_allclose(found, array, atol=1e-4 if name == "vector" else 1)


def test_a_goal_that_is_only_seen_is_in_no_number():
    seen = dataclasses.replace(OBSERVATION, goal="seen")
    told, untold = (
        {field.name for field in encoder.fields(CONFIG) if field.reveals_goal}
        for encoder in (OBSERVATION, seen)
    )
    assert untold == {"camera_seen"} < told
    assert ENCODERS["cameras"] is CameraObservation
    with pytest.raises(ValueError, match="goal 'seen' needs fixed goals"):
        dataclasses.replace(CONFIG, observation=seen, goals=GoalConfig(dynamic=True))


def test_a_route_leads_to_the_goal_until_a_camera_sees_it():
    seeing = dataclasses.replace(environment("sees").observation, width=24, height=18)
    config = dataclasses.replace(environment("sees"), layout="lot", observation=seeing)
    told = dataclasses.replace(POSES, route=True)
    env, names = ParkingEnv(config, SlidePhysics()), ("route_next", "route_length")

    @jax.jit
    @jax.vmap
    def look(key):
        state, _ = env.reset(key)
        offset = state.layout.bay_pose[state.goal] - observed(state).pose_w
        seen, all_told = (x.values(config, state) for x in (seeing, told))
        return (
            offset[..., :2],
            {name: seen[name] for name in (*names, "camera_seen")},
            {name: all_told[name] for name in names},
        )

    keys = jax.random.split(jax.random.key(0), 32)
    offset, seen, all_told = jax.device_get(look(keys))
    # On the last stretch the route's next point is as far off as the goal.
    reach = np.linalg.norm(all_told["route_next"], axis=-1) * FAR
    last = np.abs(reach - np.linalg.norm(offset, axis=-1)) < 1e-3
    in_view = (seen["camera_seen"] == Seen.OWN_BAY).any(axis=-1)
    for name in names:
        silent = (seen[name] == 0.0).all(axis=-1)
        np.testing.assert_array_equal(silent, last & in_view)
        np.testing.assert_array_equal(seen[name][~silent], all_told[name][~silent])
    for kind in (last & in_view, last & ~in_view, ~last):
        assert kind.any()


def test_who_sees_is_told_of_no_other_car_no_wall_and_no_goal():
    fields = make_fields(environment("sees"))
    told = {field.name for field in fields if field.reveals_goal}
    assert told == {"route_next", "route_length", "camera_seen"}
    assert not {field.group for field in fields} - {""}
    assert not {field.name for field in fields} & {"rays", "ultrasound"}
    assert not any(field.name.startswith("ring_") for field in fields)
    assert {"camera_depth", "camera_seen"} < {field.name for field in fields}

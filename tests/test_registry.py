"""The named environments, and what any environment of the library has."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.rolling import check_roll_out

from carpark_mj.config import LAYOUTS, EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.observations import observation_size
from carpark_mj.policy.loading import load_policy
from carpark_mj.registry import ANYWHERE, environment
from carpark_mj.suite.environments import HOPE
from carpark_mj.suite.evaluation import suite_env
from carpark_mj.tasks.environment import AgentsEnvironment, JointEnv
from carpark_mj.vehicle.presets import PRESETS
from carpark_mj.wrappers.goal import GoalParking, goal_config


@pytest.mark.parametrize("name", ["anywhere", "valet"])
def test_lots_and_steps_have_the_shapes_of_the_config(name):
    env = ParkingEnv(environment(name))
    state, observation = jax.eval_shape(env.reset, jax.random.key(0))
    assert observation.shape == (env.num_agents, observation_size(env.config))
    action = jax.ShapeDtypeStruct((env.num_agents, env.action_spec.size), jnp.float32)
    after, timestep = jax.eval_shape(env.step, state, action)
    assert jax.tree.map(jnp.shape, after) == jax.tree.map(jnp.shape, state)
    assert timestep.observation.shape == observation.shape
    assert timestep.reward.shape == (env.num_agents,)


@pytest.mark.slow
def test_anywhere_s_agents_are_some_and_drive_cars_of_all_kinds():
    """In lots of one of its families, on quick physics."""
    config = dataclasses.replace(
        ANYWHERE, layout="garage_row", num_agents=3, physics="bicycle"
    )
    env = ParkingEnv(config)

    @jax.jit
    def drive(keys):
        state, observation = jax.vmap(env.reset)(keys)

        def step(state, key):
            action = jax.random.uniform(key, (12, 3, 2), minval=-1.0)
            return jax.vmap(env.step)(state, action)

        steps = jax.random.split(jax.random.key(1), 40)
        _, timesteps = jax.lax.scan(step, state, steps)
        return state.replace(key=jnp.zeros(12)), observation, timesteps

    driven = drive(jax.random.split(jax.random.key(0), 12))
    state, observation, timesteps = jax.device_get(driven)
    assert set(state.present.sum(axis=1).tolist()) == {1, 2, 3}
    length = timesteps.motion.size[:, state.present][..., 0].round(3)
    known = {round(car.length, 3) for car in PRESETS.values()}
    found = {round(float(x), 3) for x in np.unique(length)}
    assert found <= known
    assert len(found) >= 3
    # They observe and earn finite numbers; who is absent sees zeros.
    seen = np.concatenate([observation[None], timesteps.observation])
    assert np.isfinite(seen).all()
    assert np.isfinite(timesteps.reward).all()
    np.testing.assert_array_equal(seen[:, ~state.present], 0.0)
    assert (np.abs(seen[:, state.present]).max(axis=-1) > 0.0).all()
    assert timesteps.events.done[:, state.present].any()


def test_hope_is_the_task_of_the_suite():
    names = [name for name in LAYOUTS if name.startswith("hope")]
    assert sorted(HOPE.layout.split(",")) == names
    suite = suite_env(HOPE, "strict")
    assert HOPE.episode.max_steps == suite.episode.max_steps
    same = dataclasses.replace(suite, layout=HOPE.layout, episode=HOPE.episode)
    assert same == HOPE


@pytest.mark.parametrize("name", ["anywhere", "considerate", "hope", "sees"])
def test_shipped_policies_have_the_environments_of_their_names(name):
    assert load_policy(name).env == environment(name)


# Any environment


SMALL = EnvConfig(num_parked_cars=2, physics="bicycle")
ENVIRONMENTS = {
    "lot": lambda: ParkingEnv(SMALL),
    "lot of one episode each": lambda: JointEnv(SMALL),
    "lot with a goal pose": lambda: GoalParking(goal_config({"physics": "bicycle"})),
}


@pytest.mark.parametrize("lots", [(), (3,)])
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_roll_out_is_the_same_for_every_environment(name, lots):
    env = ENVIRONMENTS[name]()
    assert env.respawns == (name == "lot")
    check_roll_out(env, lots)


def test_agents_with_one_episode_each_have_names():
    env: AgentsEnvironment = ENVIRONMENTS["lot of one episode each"]()
    assert env.agents == [f"agent_{k}" for k in range(env.num_agents)]

"""The parking lot and the junction are environments of one protocol."""

import jax
import jax.numpy as jnp
import pytest

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.policy.rollout import Carry, roll_out
from carpark_mj.studies.cederle.junction import JunctionConfig, JunctionEnv
from carpark_mj.tasks.environment import AgentsEnvironment, Environment
from carpark_mj.tasks.joint import JointEnv
from carpark_mj.wrappers.goal import GoalParking
from carpark_mj.wrappers.gymnasium_goal import goal_config

SMALL = EnvConfig(num_parked_cars=2, physics="bicycle")
STEPS = 2
ENVIRONMENTS = {
    "lot": lambda: ParkingEnv(SMALL),
    "lot of one episode each": lambda: JointEnv(SMALL),
    "lot with a goal pose": lambda: GoalParking(goal_config({"physics": "bicycle"})),
    "junction": lambda: JunctionEnv(JunctionConfig(respawn=False)),
    "junction in images": lambda: JunctionEnv(
        JunctionConfig(observation="image", shuffle=True)
    ),
}


@pytest.mark.parametrize("lots", [(), (3,)])
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_roll_out_is_the_same_for_every_environment(name, lots):
    env = ENVIRONMENTS[name]()
    assert isinstance(env, Environment)
    assert env.respawns == (name in ("lot", "junction in images"))
    spec, agents = env.action_spec, (*lots, env.num_agents)

    def act(state, observation, memory, key):
        return jnp.zeros((*agents, spec.size), spec.dtype), memory

    def run(key):
        keys = jax.random.split(key, lots) if lots else key
        start = Carry(*(jax.vmap(env.reset) if lots else env.reset)(keys))
        steps = jax.random.split(key, STEPS)
        return start, *roll_out(env, act, start, steps, lambda step: step)

    start, end, made = jax.eval_shape(run, jax.random.key(0))
    assert jax.tree.map(lambda x: (x.shape, x.dtype), start) == jax.tree.map(
        lambda x: (x.shape, x.dtype), end
    )
    assert start.observation.shape[: len(agents)] == agents
    assert jnp.issubdtype(start.state.key.dtype, jax.dtypes.prng_key)
    assert start.state.active.shape == agents
    step, events = made.timestep, made.timestep.events
    assert step.observation.shape == (STEPS, *start.observation.shape)
    if step.final_observation is not None:
        assert step.final_observation.shape == step.observation.shape
    assert step.reward.shape == (STEPS, *agents)
    for flags in (step.terminated, step.truncated, events.success, events.crashed):
        assert (flags.shape, flags.dtype) == ((STEPS, *agents), bool)


@pytest.mark.parametrize("name", ["lot of one episode each", "junction"])
def test_agents_with_one_episode_each_have_names(name):
    env: AgentsEnvironment = ENVIRONMENTS[name]()
    assert env.agents == [f"agent_{k}" for k in range(env.num_agents)]

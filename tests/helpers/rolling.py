"""Roll-outs of any environment of `carpark_mj.tasks.environment`."""

import jax
import jax.numpy as jnp

from carpark_mj.policy.acting import Carry, roll_out
from carpark_mj.tasks.environment import Environment

STEPS = 2


def check_roll_out(env, lots):
    """Asserts shapes and types of a roll-out; `lots` is (count,), or () for one lot."""
    assert isinstance(env, Environment)
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

"""Lots with people stay finite under controls drawn anew every second.

    TEST_PLATFORM=cuda AGENT_STEPS=1e9 pytest tests/integration/test_inhabited.py -n 0

makes so many control steps of agents on a GPU.
"""

import dataclasses
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiling import optimized_jit

from carpark_mj.env import ParkingEnv
from carpark_mj.registry import environment

AGENT_STEPS = float(os.environ.get("AGENT_STEPS", "1e4"))
LOTS, STEPS = (8, 50) if jax.default_backend() == "cpu" else (8192, 1000)
HOLD = 5  # control steps with equal controls


@pytest.mark.slow
def test_lots_with_people_stay_finite():
    movers = ("pedestrians:number=20",)
    env = ParkingEnv(dataclasses.replace(environment("square"), movers=movers))
    shape = (LOTS, env.num_agents, env.action_spec.size)

    def step(carry, key):
        state, good, crashed = carry
        action = jax.random.uniform(key, shape, minval=-1.0)
        state, timestep = jax.vmap(env.step)(state, action)
        for x in jax.tree.leaves((state, timestep)):
            if jnp.issubdtype(x.dtype, jnp.floating):
                good = good & jnp.isfinite(x).all()
        good = good & ~timestep.events.diverged.any()
        return (state, good, crashed + timestep.events.crashed.sum()), None

    @optimized_jit
    def drive(key):
        start_key, drive_key = jax.random.split(key)
        keys = jax.random.split(drive_key, STEPS // HOLD)[np.arange(STEPS) // HOLD]
        state, _ = jax.vmap(env.reset)(jax.random.split(start_key, LOTS))
        return jax.lax.scan(step, (state, jnp.array(True), 0), keys)[0][1:]

    rounds = int(-(-AGENT_STEPS // (STEPS * LOTS * env.num_agents)))
    for number in range(rounds):
        good, crashed = drive(jax.random.fold_in(jax.random.key(0), number))
        assert good, number
        assert crashed > 0

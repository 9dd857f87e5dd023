"""Lots with movers: they stay finite, and scene physics judges who is hit.

    TEST_PLATFORM=cuda AGENT_STEPS=1e9 pytest tests/integration/test_inhabited.py -n 0

makes so many control steps of agents among people on a GPU.
"""

import dataclasses
import os

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.compiling import optimized_jit

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.movers.scripted import ScriptedBox, ScriptedPerson
from carpark_mj.registry import environment
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.vehicle import COMPACT

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


@pytest.mark.slow
def test_who_is_hit_is_reported_as_in_mjx_and_stops_the_car():
    """Two cars drive at a person and a cart, in `mjx` and in `scene` physics."""
    person = ScriptedPerson(start=(1.0, 0.0, 0.0), trigger=0.0)  # both stand
    cart = ScriptedBox(start=(1.0, 7.0, 0.0), trigger=0.0, size=(1.0, 0.6))
    faces = 1.0 - person.size[0] / 2, 1.0 - cart.size[0] / 2
    start = ResetOptions(pose=jnp.array([[-4.0, 0.0, 0.0], [-4.0, 7.0, 0.0]]))
    drives = []
    for physics in ("mjx", "scene"):
        config = EnvConfig(
            num_agents=2,
            num_parked_cars=0,
            physics=physics,
            movers=(person, cart),
            episode=EpisodeConfig(respawn=False),
        )
        env = ParkingEnv(config)
        state, _ = jax.jit(env.reset)(jax.random.key(0), options=start)
        step, steps = jax.jit(env.step), []
        for _ in range(20):
            state, timestep = step(state, jnp.array([[0.0, 1.0]] * 2))
            events, motion = timestep.events, timestep.motion
            hits = jnp.stack([events.hit_person, events.hit_mover], axis=-1)
            steps.append((hits, events.done, motion.trace_w, motion.speed))
        drives.append([np.stack(x) for x in zip(*steps, strict=True)])
    (hits, done, trace, _), judged = drives
    for agent in range(2):
        end = done[:, agent].argmax()
        for one, other in zip((hits, done), judged[:2], strict=True):
            np.testing.assert_array_equal(
                one[: end + 1, agent], other[: end + 1, agent]
            )
        assert list(hits[end, agent]) == [agent == 0, agent == 1]
        np.testing.assert_allclose(
            judged[2][:end, agent], trace[:end, agent], atol=1e-4
        )
        # It drives on in `mjx`; here it is stopped at once, and bounces a little.
        deep, crushed = (
            one[end, agent, :, 0].max() + COMPACT.length / 2 - faces[agent]
            for one in (trace, judged[2])
        )
        assert deep > 0.2
        assert 0.0 < crushed < 0.1
        assert judged[3][end - 1, agent] > 2.0
        assert -0.3 * 2.5 < judged[3][end, agent] < 0.1

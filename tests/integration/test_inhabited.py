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


@pytest.fixture(scope="module")
def driven():
    """Steps of a lot in `mjx` and in `scene` physics.

    Two cars drive at a person and a cart, a third stands where a box rolls.
    """
    person = ScriptedPerson(start=(1.0, 0.0, 0.0), trigger=0.0)  # both stand
    cart = ScriptedBox(start=(1.0, 7.0, 0.0), trigger=0.0, size=(1.0, 0.6))
    rolls = {"start": (-3.5, -7.0, 0.0), "after": 0.0, "distance": 20.0}
    roller = dataclasses.replace(cart, **rolls, yields=False)
    pose = [[-4.0, 0.0, 0.0], [-4.0, 7.0, 0.0], [0.0, -7.0, 0.0]]
    start, drives = ResetOptions(pose=jnp.array(pose)), []
    for physics in ("mjx", "scene"):
        config = EnvConfig(
            num_agents=3,
            num_parked_cars=0,
            physics=physics,
            movers=(person, cart, roller),
            episode=EpisodeConfig(respawn=False),
        )
        env = ParkingEnv(config)
        state, _ = jax.jit(env.reset)(jax.random.key(0), options=start)
        step, steps = jax.jit(env.step), []
        for _ in range(20):
            state, timestep = step(state, jnp.array([[0.0, 1.0]] * 2 + [[0.0, 0.0]]))
            events, motion = timestep.events, timestep.motion
            hits = jnp.stack([events.hit_person, events.hit_mover], axis=-1)
            steps.append((hits, events.done, motion.trace_w, motion.speed))
            place = motion.pose_w[2, 0], state.movers.groups[2].pose_w[0, 0]
            steps[-1] += (jnp.stack(place),)
        drives.append([np.stack(x) for x in zip(*steps, strict=True)])
    return drives, (1.0 - person.size[0] / 2, 1.0 - cart.size[0] / 2)


@pytest.mark.slow
def test_who_is_hit_is_reported_as_in_mjx_and_stops_the_car(driven):
    ((hits, done, trace, *_), judged), faces = driven
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


@pytest.mark.slow
def test_a_mover_pushes_a_standing_car_from_step_to_step(driven):
    both, _ = driven
    # The face of the box is 3 m behind the middle of the car at first.
    first = np.floor((3.0 - COMPACT.length / 2) / 0.2)
    assert [hits[:, 2, 1].argmax() for hits, *_ in both] == [first, first]
    (alone, _), (car, box) = (places[11] for *_, places in both)
    assert alone == 0.0
    # A car that has crashed brakes, and what pushes is stronger.
    assert abs((car - COMPACT.length / 2) - (box + 0.5)) < 0.1
    assert car > 0.5

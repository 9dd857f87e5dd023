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

from carpark_mj.config import EnvConfig, EpisodeConfig, Mover
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry.obstacles import Boxes
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
    person = ScriptedPerson(start=(1.0, 0.0, 0.0), trigger=1e-3)  # both stand
    cart = ScriptedBox(start=(1.0, 7.0, 0.0), trigger=1e-3, size=(1.0, 0.6))
    faces = 1.0 - person.size[0] / 2, 1.0 - cart.size[0] / 2
    start = ResetOptions(pose=jnp.array([[-4.0, 0.0, 0.0], [-4.0, 7.0, 0.0]]))
    driven = []
    for physics in ("mjx", "scene"):
        config = EnvConfig(num_parked_cars=0, physics=physics, movers=(person, cart))
        env = ParkingEnv(config)
        state, _ = jax.jit(env.reset)(jax.random.key(0), options=start)
        step = jax.jit(env.step)
        steps = []
        while len(steps) < 20:
            state, timestep = step(state, jnp.array([[0.0, 1.0]] * 2))
            events = timestep.events
            hits = jnp.stack([events.hit_person, events.hit_mover], axis=-1)
            motion = timestep.motion
            steps.append((hits, events.done, motion.trace_w, motion.speed))
        driven.append([np.stack(x) for x in zip(*steps, strict=True)])
    (hits, done, trace, _), judged = driven
    last = done.argmax(axis=0)  # of the first episodes
    for agent in range(2):
        end = last[agent]
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


@dataclasses.dataclass(frozen=True)
class Roller(Mover):
    """A box that rolls on at a speed and yields to nothing."""

    speed: float = 1.0
    mover: str = "roller"

    def init(self, key, layout):
        return jnp.float32(-3.5)

    def step(self, key, state, lot, dt):
        return state + self.speed * dt

    def obstacles(self, state):
        pose = jnp.stack([state, 0.0 * state, 0.0 * state])[None]
        velocity = jnp.array([[self.speed, 0.0]])
        return [Boxes(pose, jnp.array([[1.0, 0.6]]), velocity)]


@pytest.mark.slow
def test_a_mover_pushes_a_standing_car_from_step_to_step():
    start = ResetOptions(pose=jnp.zeros((1, 3)))
    ends = []
    for physics in ("mjx", "scene"):
        config = EnvConfig(
            num_agents=1,
            num_parked_cars=0,
            physics=physics,
            movers=(Roller(),),
            episode=EpisodeConfig(respawn=False),
        )
        env = ParkingEnv(config)
        state, _ = jax.jit(env.reset)(jax.random.key(0), options=start)
        step, hits = jax.jit(env.step), []
        for _ in range(12):
            state, timestep = step(state, jnp.zeros((1, 2)))
            hits.append(bool(timestep.events.hit_mover[0]))
        ends.append((np.argmax(hits), state))
    (first, alone), (judged, pushed) = ends
    # The face of the box is 3 m behind the middle of the car at first.
    assert first == judged == np.floor((3.0 - COMPACT.length / 2) / 0.2)
    assert float(alone.motion.pose_w[0, 0]) == 0.0
    face = float(pushed.movers.groups[0].pose_w[0, 0]) + 0.5
    tail = float(pushed.motion.pose_w[0, 0]) - COMPACT.length / 2
    # A car that has crashed brakes, and what pushes is stronger.
    assert abs(tail - face) < 0.1
    assert tail + COMPACT.length / 2 > 0.5

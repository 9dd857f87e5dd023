"""Times what is done in a control step, in a small and a large lot."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax

from carpark_mj.benchmarking.timing import best_time
from carpark_mj.config import EnvConfig, RayConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import LotConfig
from carpark_mj.mdp.clearance import clearances
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.metrics.collision_time import collision_times
from carpark_mj.observations import ContinuousObservation, observe
from carpark_mj.obstacles.lot import lot_obstacles
from carpark_mj.types import State

SCENES = {
    "square": EnvConfig(num_agents=7, num_parked_cars=16),
    "large": EnvConfig(
        layout=LotConfig(num_aisles=(8, 8), bays_per_row=(26, 26), pillar_every=5),
        num_agents=50,
        num_parked_cars=300,
    ),
}


def make_env(scene: str, rays: int) -> ParkingEnv:
    """The environment of a scene of `SCENES`; with `rays` bearings, if above 0."""
    config = SCENES[scene]
    if rays:
        seen = ContinuousObservation(rays=RayConfig(rays))
        config = dataclasses.replace(config, observation=seen)
    return ParkingEnv(config)


def measure(
    env: ParkingEnv, num_lots: int, num_steps: int, repeats: int
) -> dict[str, float]:
    """Milliseconds of a control step of all lots, by what is done in it.

    Args:
        env: simulated.
        num_lots: in a batch.
        num_steps: control steps driven before and during a timing.
        repeats: timings, of which the best counts.
    """
    reset_key, action_key = jax.random.split(jax.random.key(0))
    shape = (num_steps, num_lots, env.num_agents, 2)
    actions = jax.random.uniform(action_key, shape, minval=-1.0)

    def safety(state: State) -> Any:
        motion = state.motion
        there = lot_obstacles(state.layout, motion, state.parked_cars, state.movers)
        return clearances(motion, there), collision_times(motion, there)

    @jax.jit
    def drive(state: State) -> State:
        step = jax.vmap(env.step)
        return jax.lax.scan(lambda s, a: (step(s, a)[0], None), state, actions)[0]

    keys = jax.random.split(reset_key, num_lots)
    state = drive(jax.jit(jax.vmap(env.reset))(keys)[0])
    see = jax.jit(jax.vmap(lambda state: observe(env.config, state)))

    def milliseconds(function: Callable[..., Any]) -> float:
        jax.block_until_ready(function(state))  # compiles
        return 1e3 * best_time(lambda: function(state), repeats)

    return {
        "collisions": milliseconds(jax.jit(jax.vmap(find_hits))),
        "observations": milliseconds(see),
        "safety": milliseconds(jax.jit(jax.vmap(safety))),
        "whole step": milliseconds(drive) / num_steps,
    }

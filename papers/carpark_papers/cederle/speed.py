"""Measures agent steps per second at the road junction, auto-resets included.

carpark_mj study junction_speed
carpark_mj study junction_speed --cars mjx --observations image --junctions 1024

Actions are random. Times are of the machine it runs on.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from rich.console import Console
from rich.table import Table

from carpark_mj.benchmarking import best_time
from carpark_mj.cli.process import enable_output_fusion
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_papers.cederle.junction import JunctionConfig, JunctionEnv
from carpark_papers.cederle.junction.config import CarModel, Encoding
from carpark_papers.cederle.junction.rules import ACTIONS


@dataclasses.dataclass(frozen=True)
class JunctionSpeedConfig(CheckedConfig):
    """Settings of `carpark_mj study junction_speed`.

    Attributes:
        scenario: `2av`, `2av-hd`, `3av` or `3av-hd`.
        cars: back ends to measure.
        observations: encodings to measure.
        junctions: number of junctions in a batch.
        steps: control steps in a timing.
        repeats: number of timings; the best is reported.
    """

    scenario: str = "3av-hd"
    cars: tuple[CarModel, ...] = ("path", "bicycle", "mjx")
    observations: tuple[Encoding, ...] = ("vector", "image")
    junctions: Count = 64
    steps: Count = 50
    repeats: Count = 5

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("cars", "observations"):
            if not getattr(self, name):
                raise ValueError(f"{name} must name at least one")


def speed(env: JunctionEnv, config: JunctionSpeedConfig) -> float:
    """Agent steps per second."""
    shape = config.steps, config.junctions, env.num_agents
    action = jax.random.randint(jax.random.key(1), shape, 0, len(ACTIONS))

    def step(state: Any, action: jax.Array) -> tuple[Any, Any]:
        state, timestep = jax.vmap(env.step)(state, action)
        seen = jnp.sum(timestep.observation, axis=range(1, timestep.observation.ndim))
        return state, (seen, timestep.reward)

    keys = jax.random.split(jax.random.key(0), config.junctions)
    state, _ = jax.jit(jax.vmap(env.reset))(keys)
    run = jax.jit(lambda state: jax.lax.scan(step, state, action))
    jax.block_until_ready(run(state))
    return action.size / best_time(lambda: run(state), config.repeats)


def main(config: JunctionSpeedConfig) -> None:
    """Measures and prints the table."""
    device = jax.devices()[0].device_kind
    title = f"agent steps/s, {config.junctions} junctions {config.scenario} on {device}"
    table = Table("cars", *config.observations, title=title)
    for cars in config.cars:
        envs = (
            JunctionEnv(JunctionConfig(config.scenario, cars=cars, observation=seen))
            for seen in config.observations
        )
        table.add_row(cars, *(f"{speed(env, config):,.0f}" for env in envs))
    Console().print(table)


def run(arguments: Sequence[str] | None = None) -> None:
    """Runs the command."""
    from carpark_mj.cli.flags import read_flags

    enable_output_fusion()
    main(read_flags(JunctionSpeedConfig, arguments, description=__doc__))

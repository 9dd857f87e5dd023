"""Measures what collisions, observations and a whole step cost, by size of the lot.

*safety* are clearance and time to collision, which a whole step leaves out by default.

python eval/broad_phase.py
python eval/broad_phase.py --lots 4 --scenes large

`square`: 7 agents and 16 parked cars in the square lot. `large`: 50 agents and 300
parked cars in a car park of 400 bays. Times are of the machine it runs on; compare only
figures of one run.
"""

import dataclasses
import sys
from collections.abc import Callable
from typing import Any

import jax
import tyro
from rich.console import Console
from rich.table import Table

from benchmarking.timing import best_time
from carpark_mj.cli.common import USER_ERRORS, one_line
from carpark_mj.config import EnvConfig, RayConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts.lot_config import LotConfig
from carpark_mj.mdp.clearance import clearances
from carpark_mj.mdp.collisions import find_hits
from carpark_mj.mdp.metrics.collision_time import collision_times
from carpark_mj.observations import observe
from carpark_mj.types import State

SCENES = {
    "square": EnvConfig(num_agents=7, num_parked_cars=16),
    "large": EnvConfig(
        layout=LotConfig(num_aisles=(8, 8), bays_per_row=(26, 26), pillar_every=5),
        num_agents=50,
        num_parked_cars=300,
    ),
}


@dataclasses.dataclass(frozen=True)
class BroadPhaseConfig:
    """Settings of `python eval/broad_phase.py`.

    Attributes:
        scenes: scenes to measure, `square` and `large`.
        lots: number of lots in a batch.
        steps: control steps driven before and during a timing.
        repeats: number of timings; the best is reported.
        rays: number of rays observed; 0 = none.
    """

    scenes: tuple[str, ...] = tuple(SCENES)
    lots: int = 16
    steps: int = 10
    repeats: int = 5
    rays: int = 0

    def __post_init__(self) -> None:
        for name in ("lots", "steps", "repeats"):
            if getattr(self, name) < 1:
                raise ValueError(
                    f"{name} must be at least 1, not {getattr(self, name)}"
                )
        if unknown := set(self.scenes) - set(SCENES):
            raise ValueError(
                f"unknown scenes {sorted(unknown)}; choose from {sorted(SCENES)}"
            )


def milliseconds(
    config: BroadPhaseConfig, function: Callable[..., Any], *args: Any
) -> float:
    """Of the fastest call after the first, which compiles."""
    jax.block_until_ready(function(*args))
    return 1e3 * best_time(lambda: function(*args), config.repeats)


def measure(config: BroadPhaseConfig, env: ParkingEnv) -> dict[str, float]:
    """Milliseconds of a control step of all lots, by what is done in it."""
    reset_key, action_key = jax.random.split(jax.random.key(0))
    shape = (config.steps, config.lots, env.num_agents, 2)
    actions = jax.random.uniform(action_key, shape, minval=-1.0)

    def safety(state: State) -> Any:
        where = state.layout, state.motion, state.parked_cars
        return clearances(*where), collision_times(*where)

    @jax.jit
    def drive(state: State) -> State:
        step = jax.vmap(env.step)
        return jax.lax.scan(lambda s, a: (step(s, a)[0], None), state, actions)[0]

    keys = jax.random.split(reset_key, config.lots)
    state = drive(jax.jit(jax.vmap(env.reset))(keys)[0])
    see = jax.jit(jax.vmap(lambda state: observe(env.config, state)))
    return {
        "collisions": milliseconds(config, jax.jit(jax.vmap(find_hits)), state),
        "observations": milliseconds(config, see, state),
        "safety": milliseconds(config, jax.jit(jax.vmap(safety)), state),
        "whole step": milliseconds(config, drive, state) / config.steps,
    }


def main(config: BroadPhaseConfig) -> None:
    """Measures and prints the table."""
    device = jax.devices()[0].device_kind
    table = Table(title=f"ms a control step of {config.lots} lots on {device}")
    for name in (
        "scene",
        "agents",
        "bays",
        "walls",
        "discs",
        "collisions",
        "observations",
        "safety",
        "whole step",
    ):
        table.add_column(name, justify="left" if name == "scene" else "right")
    for name in config.scenes:
        env_config = SCENES[name]
        if config.rays:
            seen = dataclasses.replace(
                env_config.observation, rays=RayConfig(config.rays)
            )
            env_config = dataclasses.replace(env_config, observation=seen)
        env = ParkingEnv(env_config)
        layout = jax.eval_shape(env.draw_layout, jax.random.key(0))
        rows = (layout.bay_mask, layout.wall_mask, layout.disc_mask)
        table.add_row(
            name,
            str(env.num_agents),
            *(str(mask.shape[0]) for mask in rows),
            *(f"{value:.2f}" for value in measure(config, env).values()),
        )
    Console().print(table)


if __name__ == "__main__":
    try:
        main(tyro.cli(BroadPhaseConfig, description=__doc__))
    except USER_ERRORS as error:
        print(f"broad_phase: {one_line(error)}", file=sys.stderr)
        sys.exit(2)

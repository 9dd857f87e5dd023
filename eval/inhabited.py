"""Runs inhabited lots for long and looks for states that are not finite.

python eval/inhabited.py
python eval/inhabited.py --num-lots 64 --agent-steps 200000

Cars hold random controls for a second. Seed and round determine everything, so a round
that fails can be repeated with `--seed` and `--first-round`.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("inhabited", "inhabited:main")

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from carpark_mj.cli.common import enable_output_fusion, run_command
from carpark_mj.config.checks import require_count
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.keys import require_seed
from carpark_mj.registry import environment

HOLD = 5  # control steps of the same controls
FOUND = ("not finite", "diverged", "crashed", "hit a person", "parked")


@dataclasses.dataclass(frozen=True)
class InhabitedConfig:
    """Settings of `python eval/inhabited.py`.

    Attributes:
        environment: name of an environment.
        movers: what lives in its lots, see `carpark_mj.config.obstacles.make_movers`.
        agent_steps: control steps of agents to make, rounded up to whole rounds.
        num_lots: number of lots simulated in parallel.
        round_steps: control steps of a round, after which lots begin anew.
        first_round: number of the first round.
        seed: of everything that is drawn.
    """

    environment: str = "square"
    movers: tuple[str, ...] = ("pedestrians:number=20",)
    agent_steps: int = 1_000_000_000
    num_lots: int = 8192
    round_steps: int = 1000
    first_round: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("agent_steps", "num_lots", "round_steps"):
            require_count(name, getattr(self, name), 1)
        require_count("first_round", self.first_round, 0)
        require_seed(self.seed)


def make_round(
    env: ParkingEnv, num_lots: int, num_steps: int
) -> Callable[[jax.Array], jax.Array]:
    """Returns a compiled round `key -> counts` (5,) of what is in `FOUND`.

    The first is the number of lots in which a state, an observation or a reward was not
    finite after any step, the others are events of agents.
    """
    holds = -(-num_steps // HOLD)
    shape = (num_lots, env.num_agents, env.action_spec.size)

    def step(action: jax.Array, carry: Any) -> tuple[Any, None]:
        state, bad, counts = carry
        state, timestep = jax.vmap(env.step)(state, action)
        for x in jax.tree.leaves((state, timestep)):
            if jnp.issubdtype(x.dtype, jnp.floating):
                bad = bad | ~jnp.isfinite(x).reshape(num_lots, -1).all(axis=1)
        events = timestep.events
        person = events.hit_person
        found = (
            events.diverged,
            events.crashed,
            jnp.zeros_like(events.crashed) if person is None else person,
            events.parked,
        )
        return (state, bad, counts + jnp.stack([x.sum() for x in found])), None

    def hold(carry: Any, key: jax.Array) -> tuple[Any, None]:
        action = jax.random.uniform(key, shape, minval=-1.0)
        return jax.lax.scan(lambda c, _: step(action, c), carry, None, HOLD)

    def run(key: jax.Array) -> jax.Array:
        start_key, drive_key = jax.random.split(key)
        state, _ = jax.vmap(env.reset)(jax.random.split(start_key, num_lots))
        begin = state, jnp.zeros(num_lots, bool), jnp.zeros(4, jnp.int32)
        keys = jax.random.split(drive_key, holds)
        (_, bad, counts), _ = jax.lax.scan(hold, begin, keys)
        return jnp.concatenate([bad.sum(dtype=jnp.int32)[None], counts])

    return jax.jit(run)


def run(config: InhabitedConfig) -> int:
    """Runs the rounds and prints what was found; 1 if a state was not finite."""
    base = environment(config.environment)
    env = ParkingEnv(dataclasses.replace(base, movers=config.movers))
    steps = -(-config.round_steps // HOLD) * HOLD
    size = steps * config.num_lots * env.num_agents
    rounds = -(-config.agent_steps // size)
    make = make_round(env, config.num_lots, steps)
    print(f"{rounds} rounds of {size:.3g} agent-steps; compiling ...", flush=True)
    begun, total = time.monotonic(), [0] * len(FOUND)
    for number in range(config.first_round, config.first_round + rounds):
        key = jax.random.fold_in(jax.random.key(config.seed), number)
        counts = [int(x) for x in jax.device_get(make(key))]
        total = [a + b for a, b in zip(total, counts, strict=True)]
        done = (number - config.first_round + 1) * size
        told = [f"{name} {x}" for name, x in zip(FOUND, total, strict=True)]
        seconds = time.monotonic() - begun
        print(
            f"round {number}: {done:.4g} agent-steps, {seconds:.0f} s;",
            ", ".join(told),
            flush=True,
        )
    return int(any(total[:2]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit code."""
    enable_output_fusion()

    def command() -> object:
        from carpark_mj.cli.flags import read_flags

        return run(read_flags(InhabitedConfig, arguments, description=__doc__))

    return run_command("inhabited", command)

"""Runs lots with movers for long; counts non-finite states and overlaps.

python eval/inhabited.py
python eval/inhabited.py --environment considerate --layout lot --overlaps

Cars hold random controls for a second. Seed and round determine everything, so a round
that fails can be repeated with `--seed` and `--first-round`. `--overlaps` runs one
round and prints how often movers overlap each other and standing obstacles.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("inhabited", "inhabited:main")

import dataclasses
import itertools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import CheckedConfig, Count, Natural, require_seed
from carpark_mj.env import ParkingEnv
from carpark_mj.geometry import norm, to_local
from carpark_mj.geometry.obstacles import Boxes, Discs, Group, ObstacleKind
from carpark_mj.obstacles import lot_obstacles
from carpark_mj.registry import environment
from carpark_mj.types import State
from shell import command

HOLD = 5  # control steps with equal controls
FOUND = ("not finite", "diverged", "crashed", "hit a person", "parked")
DEEP = (1e-3, 0.05, 0.2)  # m, overlaps that are told apart


@dataclasses.dataclass(frozen=True)
class InhabitedConfig(CheckedConfig):
    """Settings of `python eval/inhabited.py`.

    Attributes:
        environment: name of an environment.
        movers: moving obstacles of its lots, see `carpark_mj.obstacles.make_movers`.
        agent_steps: control steps of agents to make, rounded up to whole rounds.
        num_lots: number of lots simulated in parallel.
        round_steps: control steps of a round, after which lots are reset.
        first_round: number of the first round.
        seed: of all random draws.
        layout: of the lots; "" = that of the environment.
        overlaps: whether to count overlaps, in one round.
    """

    environment: str = "square"
    movers: tuple[str, ...] = ("pedestrians:number=20",)
    agent_steps: Count = 1_000_000_000
    num_lots: Count = 8192
    round_steps: Count = 1000
    first_round: Natural = 0
    seed: int = 0
    layout: str = ""
    overlaps: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require_seed(self.seed)


def depth(one: Group, other: Group) -> jax.Array:
    """Depths (n, m) [m] of overlaps of obstacles with others; negative where apart."""
    if isinstance(one, Discs) and isinstance(other, Discs):
        gap = norm(one.pose_w[:, None] - other.pose_w)
        return one.size[:, None] + other.size - gap
    if isinstance(one, Discs):
        return depth(other, one).T
    half = one.size[:, None] / 2
    if isinstance(other, Discs):
        centre = jnp.pad(other.pose_w, ((0, 0), (0, 1)))
        out = jnp.abs(to_local(one.pose_w[:, None], centre)[..., :2]) - half
        outside, inside = norm(jnp.maximum(out, 0.0)), jnp.minimum(out.max(-1), 0.0)
        return other.size - outside - inside
    local = to_local(one.pose_w[:, None], other.pose_w)
    back = to_local(other.pose_w, one.pose_w[:, None])
    cos, sin = jnp.abs(jnp.cos(local[..., 2])), jnp.abs(jnp.sin(local[..., 2]))
    turn = jnp.stack([jnp.stack([cos, sin], -1), jnp.stack([sin, cos], -1)], -2)
    reach = half + jnp.einsum("...ij,...j->...i", turn, other.size / 2)
    least = (reach - jnp.abs(local[..., :2])).min(axis=-1)
    reach = other.size / 2 + jnp.einsum("...ij,...j->...i", turn, half)
    return jnp.minimum(least, (reach - jnp.abs(back[..., :2])).min(axis=-1))


def overlaps(state: State) -> dict[str, tuple[jax.Array, jax.Array]]:
    """Depths (n,) [m] of movers of one kind in obstacles of another, and presence."""
    obstacles = lot_obstacles(state.layout, None, state.parked_cars)
    groups = [*state.movers.groups, *obstacles]
    agents = Boxes(state.motion.pose_w, state.motion.size, mask=state.active)
    groups.append(dataclasses.replace(agents, kind=ObstacleKind.AGENT))
    found: dict[str, list[tuple[jax.Array, jax.Array]]] = {}
    for one, kind in itertools.product(state.movers.groups, ObstacleKind):
        there = jnp.ones(one.count, bool) if one.mask is None else one.mask
        deepest = []
        for other in groups:
            if other.kind != kind or not other.count:
                continue
            counts = jnp.ones(other.count, bool) if other.mask is None else other.mask
            deep = jnp.where(counts, depth(one, other), -1.0)
            if other is one:
                deep = deep - 1e6 * jnp.eye(one.count)
            deepest.append(deep.max(axis=1))
        if deepest:
            rows = found.setdefault(f"{one.kind.label} in {kind.label}", [])
            rows.append((jnp.stack(deepest).max(axis=0), there))
    joined = {k: map(jnp.concatenate, zip(*x, strict=True)) for k, x in found.items()}
    return {name: (deep, there) for name, (deep, there) in joined.items()}


def tally(state: State) -> dict[str, jax.Array]:
    """Counts (5,) for each pair of kinds: present, `DEEP`, and the deepest [m]."""

    def count(deep: jax.Array, there: jax.Array) -> jax.Array:
        deep = jnp.where(there, deep, -1.0)
        counts = [there.sum(), *((deep > least).sum() for least in DEEP)]
        return jnp.stack([*(x.astype(jnp.float32) for x in counts), deep.max()])

    return {name: count(*row) for name, row in overlaps(state).items()}


def _add(one: Any, other: Any) -> Any:
    """Sums of tallies, of the deepest overlaps the larger."""

    def add(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.append(a[:4] + b[:4], jnp.maximum(a[4], b[4]))

    return jax.tree.map(add, one, other)


def _make_run(
    env: ParkingEnv, num_lots: int, begin: Callable[..., Any], count: Callable[..., Any]
) -> Callable[[jax.Array, jax.Array], Any]:
    """Returns a compiled run of lots, `start key, keys of the steps -> counts`.

    These are `begin(state)`, and after a step `count(counts, state, time step)`.
    """
    shape = (num_lots, env.num_agents, env.action_spec.size)

    def step(carry: Any, key: jax.Array) -> tuple[Any, None]:
        state, counts = carry
        action = jax.random.uniform(key, shape, minval=-1.0)
        state, timestep = jax.vmap(env.step)(state, action)
        return (state, count(counts, state, timestep)), None

    def run(start_key: jax.Array, keys: jax.Array) -> Any:
        state, _ = jax.vmap(env.reset)(jax.random.split(start_key, num_lots))
        return jax.lax.scan(step, (state, begin(state)), keys)[0][1]

    return jax.jit(run)


def make_round(
    env: ParkingEnv, num_lots: int, num_steps: int
) -> Callable[[jax.Array], jax.Array]:
    """Returns a round `key -> counts` (5,) of what is in `FOUND`.

    The first counts lots in which a number was not finite, the others events of agents.
    """
    holds = -(-num_steps // HOLD)

    def begin(_: State) -> Any:
        return jnp.zeros(num_lots, bool), jnp.zeros(4, jnp.int32)

    def count(counts: Any, state: State, timestep: Any) -> Any:
        bad, total = counts
        for x in jax.tree.leaves((state, timestep)):
            if jnp.issubdtype(x.dtype, jnp.floating):
                bad = bad | ~jnp.isfinite(x).reshape(num_lots, -1).all(axis=1)
        events, person = timestep.events, timestep.events.hit_person
        person = jnp.zeros_like(events.crashed) if person is None else person
        found = events.diverged, events.crashed, person, events.parked
        return bad, total + jnp.stack([x.sum() for x in found])

    run = _make_run(env, num_lots, begin, count)

    def drive(key: jax.Array) -> jax.Array:
        start_key, drive_key = jax.random.split(key)
        keys = jax.random.split(drive_key, holds)[np.arange(holds).repeat(HOLD)]
        bad, total = run(start_key, keys)
        return jnp.append(bad.sum(dtype=jnp.int32), total)

    return drive


def watch(env: ParkingEnv, config: InhabitedConfig) -> int:
    """Prints a table of overlaps, when lots begin and of all steps."""

    def count(state: State) -> dict[str, jax.Array]:
        rows = jax.vmap(tally)(state)
        return {
            k: jnp.append(x[:, :4].sum(axis=0), x[:, 4].max()) for k, x in rows.items()
        }

    def begin(state: State) -> Any:
        first = count(state)
        return first, {k: jnp.zeros(5).at[4].set(-1.0) for k in first}

    def add(counts: Any, state: State, _: Any) -> Any:
        return counts[0], _add(counts[1], count(state))

    key = jax.random.fold_in(jax.random.key(config.seed), config.first_round)
    start_key, drive_key = jax.random.split(key)
    steps = np.arange(config.round_steps)
    keys = jax.random.split(drive_key, len(steps))[steps - steps % HOLD]
    names = "first", "steps"
    rounds = _make_run(env, config.num_lots, begin, add)(start_key, keys)
    print(f"overlaps of more than {', '.join(f'{x:g}' for x in DEEP)} m; deepest")
    for name, counts in zip(names, jax.device_get(rounds), strict=True):
        for kinds, (there, *over, deepest) in counts.items():
            shares = " ".join(f"{100 * x / max(there, 1):7.3f} %" for x in over)
            deep = f"{deepest:.2f} m" if deepest > 0 else "–"
            print(f"{name} {kinds:24} of {there:.0f}: {shares}  {deep}")
    return 0


def run(config: InhabitedConfig) -> int:
    """Runs the rounds and prints what was found; 1 if a state was not finite."""
    base = environment(config.environment)
    layout: Any = config.layout or base.layout
    env = ParkingEnv(dataclasses.replace(base, movers=config.movers, layout=layout))
    if config.overlaps:
        return watch(env, config)
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


main = command(InhabitedConfig, run, __doc__, fused=True)

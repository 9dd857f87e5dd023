"""Evaluation of a policy: whole episodes on held-out seeds, rates with intervals.

The first few episodes of every agent count, however long they are, so that short
episodes are not over-represented. Every member of a mixture gets its exact share of the
lots, and every number of agents the same number of lots.
"""

import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config.checks import is_finite, require_count, require_seed
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import Row, complete_row, summarize
from carpark_mj.evaluation.keys import evaluation_key
from carpark_mj.layouts import member_shares
from carpark_mj.policy.acting import AnyPolicy, Carry, Step, acts, as_argument, roll_out
from carpark_mj.types import State

CHUNK = 50  # control steps per compiled call


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Results of an evaluation.

    Attributes:
        episodes: a row per episode: lot, agent, episode, the lot's number of agents and
            family, and the metrics of `carpark_mj.evaluation.catalogue`.
        summary: aggregates of all episodes, see `aggregation.summarize`.
        families: summaries of the lots of each member of a mixture, by name; the lot's
            own if it is no mixture.
        agent_counts: summaries of the lots with each number of agents.
        vehicles: summaries of each kind of car that agents drove.
    """

    episodes: list[Row]
    summary: dict[str, Any]
    families: dict[str, dict[str, Any]]
    agent_counts: dict[int, dict[str, Any]]
    vehicles: dict[str, dict[str, Any]]


def evaluate(
    env: ParkingEnv,
    policy: AnyPolicy,
    num_episodes: int,
    seed: int,
    num_lots: int = 128,
    horizon: float | None = None,
) -> Evaluation:
    """Runs at least `num_episodes` whole episodes and summarizes them.

    Policies of one kind and shapes share the programs of an environment.

    Args:
        env: with respawning agents; `MetricsConfig` says what is measured.
        policy: acting function over observations (agents, size).
        num_episodes: rounded up to the same number for every agent.
        seed: of the held-out lots, goals and spawns.
        num_lots: lots run side by side; fewer if the episodes do not fill them, but
            one for each member of a mixture with each number of agents.
        horizon: time [s] within which all episodes of these lots that begin count, any
            number per agent; None = the same number for every agent.

    Raises:
        ValueError: no episodes, or an environment without respawn, or no time.
    """
    if not env.config.episode.respawn:
        raise ValueError("evaluation needs episode.respawn = True")
    require_count("num_episodes", num_episodes, 1)
    require_count("num_lots", num_lots, 1)
    require_seed(seed)
    if horizon is not None and not (is_finite(horizon) and horizon > 0):
        raise ValueError(f"horizon must be positive, not {horizon!r}")
    member, num_present, families = _make_lots(env, num_episodes, num_lots)
    rows: list[Row] = []
    reset_key, act_key = jax.random.split(evaluation_key(seed))
    reset, chunk = _programs(env)
    begun = reset(member, num_present, reset_key)
    present = np.asarray(begun[0].takes_part).sum(axis=1)
    quota, last = math.ceil(num_episodes / present.sum()), math.inf
    if horizon is not None:
        quota, last = sys.maxsize, horizon / env.config.sim.ctrl_dt
    quotas = np.where(begun[0].takes_part, quota, 0)
    kinds, ctrl_dt = env.fleet.agent_names, env.config.sim.ctrl_dt
    chunk = functools.partial(chunk, as_argument(policy))
    ended = ended_episodes(chunk, Carry(*begun), act_key, quotas, last)
    for which, row in ended:
        lot, kind = int(which["lot"]), int(row.pop("kind"))
        which |= {"agents_present": float(present[lot])}
        names = {"family": families[member[lot]], "vehicle": kinds[kind]}
        rows.append(which | complete_row(row, ctrl_dt) | names)
    rows.sort(key=lambda row: (row["lot"], row["agent"], row["episode"]))
    return _summarized(rows, families, kinds)


@functools.lru_cache(maxsize=8)
def _programs(env: ParkingEnv) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """What starts lots and steps them, compiled once for policies of one kind."""
    reset, chunk = (functools.partial(part, env) for part in (_reset, _chunk))
    return jax.jit(reset), jax.jit(chunk)


# Makes a control step for every key (steps,) of lots; returns the carry, and of each
# step which episodes ended (steps, lots, agents) bool and their values by name.
Chunk = Callable[[Carry, jax.Array], tuple[Carry, tuple[Any, Mapping[str, Any]]]]


def ended_episodes(
    chunk: Chunk,
    carry: Carry,
    key: jax.Array,
    quota: np.ndarray,
    last: float = math.inf,
) -> Iterator[tuple[Row, Row]]:
    """Steps lots side by side until the episodes that count have ended.

    Args:
        chunk: makes `CHUNK` control steps of the lots.
        carry: the lots at their start.
        key: of what is random in the policy, consumed.
        quota: (lots, agents) the number of episodes of each agent that count.
        last: control step before which an episode begins that counts; inf = any.

    Yields:
        Of each, in the order in which they end, `lot`, `agent` and `episode`, their
        numbers, and its values by name.
    """
    finished, begun, now = np.zeros_like(quota), np.zeros(quota.shape, int), 0
    while ((finished < quota) & (begun < last)).any():
        keys = jax.random.split(jax.random.fold_in(key, now), CHUNK)
        carry, (done, values) = chunk(carry, keys)
        values = {name: np.asarray(value) for name, value in values.items()}
        for t, lot, agent in np.argwhere(np.asarray(done)):
            number = finished[lot, agent]
            if number < quota[lot, agent] and begun[lot, agent] < last:
                which = {"lot": float(lot), "agent": float(agent)}
                which |= {"episode": float(number)}
                yield which, {n: float(x[t, lot, agent]) for n, x in values.items()}
            finished[lot, agent] += 1
            begun[lot, agent] = now + t + 1
        now += CHUNK


def _summarized(
    rows: list[Row], families: Sequence[str], kinds: Sequence[str]
) -> Evaluation:
    """Summaries of all episodes, and by family, number of agents and kind of car."""

    def those(column: str, value: Any) -> list[Row]:
        return [row for row in rows if row[column] == value]

    counts = sorted({int(row["agents_present"]) for row in rows})
    driven = {row["vehicle"] for row in rows}
    return Evaluation(
        episodes=rows,
        summary=summarize(rows),
        families={name: summarize(those("family", name)) for name in families},
        agent_counts={n: summarize(those("agents_present", n)) for n in counts},
        vehicles={n: summarize(those("vehicle", n)) for n in kinds if n in driven},
    )


def _make_lots(
    env: ParkingEnv, num_episodes: int, num_lots: int
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Lots for at least so many episodes, see `evaluate`.

    Members of a mixture and numbers of agents (num_lots,) int32; the members' names.
    """
    shares, counts = member_shares(env.layout_config), env.config.agent_counts
    mean_count = (counts.start + env.num_agents) / 2
    num_lots = min(num_lots, math.ceil(num_episodes / mean_count))
    # A member gets at least its share, rounded down.
    rarest = min(shares.values()) / sum(shares.values())
    num_lots = max(num_lots, math.ceil(round(len(counts) / rarest, 6)))
    num_lots = -(-num_lots // len(counts)) * len(counts)
    # In turn, so that the lots of a family are spread over the numbers as well.
    num_present = np.resize(np.array(counts, np.int32), num_lots)
    return allot(list(shares.values()), num_lots), num_present, list(shares)


def _reset(
    env: ParkingEnv, member: jax.Array, num_present: jax.Array, key: jax.Array
) -> tuple[State, jax.Array]:
    """Held-out lots at their start; `key` is consumed."""
    varies = len(env.config.agent_counts) > 1
    keys = jax.random.split(key, len(member))
    reset = jax.vmap(lambda key, *lot: env.reset(key, "test", *lot))
    return reset(keys, member, num_present if varies else None)


def allot(shares: list[float], num_lots: int) -> np.ndarray:
    """Members (num_lots,) int32 of a mixture's lots, in proportion to their shares.

    The k-th lot goes to the member within whose part of [0, 1] (k + 1/2) / n falls.
    """
    middle = (np.arange(num_lots) + 0.5) / num_lots
    ends = np.cumsum(shares)[:-1]
    return np.searchsorted(ends, middle, side="right").astype(np.int32)


def _chunk(
    env: ParkingEnv, policy: AnyPolicy, carry: Carry, keys: jax.Array
) -> tuple[Carry, tuple[jax.Array, dict[str, jax.Array]]]:
    """See `Chunk`."""

    def report(step: Step) -> Any:
        done, kind = step.timestep.events.done, step.before.kind
        kind = jnp.zeros(done.shape, jnp.int32) if kind is None else kind
        return done, {"kind": kind, **step.timestep.metrics}

    return roll_out(env, acts(policy), carry, keys, report)

"""Evaluation of a policy: whole episodes on held-out seeds, rates with intervals.

Of every agent the first few episodes count, however long they are, so that short
episodes are not over-represented. Every member of a mixture gets its share of the lots
exactly, not by chance.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import complete_row, pool_all
from carpark_mj.layouts import member_shares
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.networks import Policy
from carpark_mj.state import State

OUTCOMES = ("parked", "crashed", "timed_out", "diverged")
HITS = ("hit_agent", "hit_parked_car", "hit_wall")
CHUNK = 50  # control steps per compiled call


def evaluation_key(seed: int) -> jax.Array:
    """The key of an evaluation; training uses `fold_in(..., 0)`, so they never meet.

    Random layouts come from the `test` split besides (`carpark_mj.layouts.splits`).
    """
    return jax.random.fold_in(jax.random.key(seed), 1)


def wilson_interval(successes: float, trials: float) -> tuple[float, float]:
    """Wilson score interval of a rate at 95 % confidence.

    Wilson 1927; keeps sensible bounds near 0 and 1. (0, 1) without trials.
    """
    if trials <= 0:
        return 0.0, 1.0
    z = 1.959964
    rate = successes / trials
    centre = rate + z * z / (2 * trials)
    spread = z * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """What an evaluation found.

    Attributes:
        episodes: a row per episode: lot, agent, episode, its metrics (see
            `carpark_mj.evaluation.catalogue`), and the lot's family by name.
        summary: episodes, rates with Wilson 95 % intervals, means, and under `metrics`
            every metric of all episodes together.
        families: the same for the lots of each member of a mixture, by name; the lot's
            own if it is no mixture.
    """

    episodes: list[dict[str, Any]]
    summary: dict[str, Any]
    families: dict[str, dict[str, Any]]


def evaluate(
    env: ParkingEnv, policy: Policy, num_episodes: int, seed: int, num_lots: int = 128
) -> Evaluation:
    """Runs at least `num_episodes` whole episodes and sums them up.

    Args:
        env: with respawning agents; `MetricsConfig` says what is measured.
        policy: acting function over observations (agents, size).
        num_episodes: rounded up to the same number for every agent.
        seed: of the held-out lots, goals and spawns.
        num_lots: lots run side by side; fewer if the episodes do not fill them, but
            one for each member of a mixture.

    Raises:
        ValueError: no episodes, or an environment without respawn.
    """
    if num_episodes < 1:
        raise ValueError(f"num_episodes must be at least 1, not {num_episodes}")
    if not env.config.episode.respawn:
        raise ValueError("evaluation needs episode.respawn = True")
    ctrl_dt = env.config.sim.ctrl_dt
    shares = member_shares(env.lot)
    num_lots = min(num_lots, -(-num_episodes // env.num_agents))
    num_lots = max(num_lots, len(shares))
    member = allot(list(shares.values()), num_lots)
    quota = -(-num_episodes // (num_lots * env.num_agents))
    reset_key, act_key = jax.random.split(evaluation_key(seed))
    reset = jax.jit(jax.vmap(lambda key, member: env.reset(key, "test", member)))
    state, observation = reset(jax.random.split(reset_key, num_lots), member)
    chunk = jax.jit(lambda carry: _chunk(env, policy, carry))
    carry = (state, observation, act_key)
    finished = np.zeros((num_lots, env.num_agents), int)
    names = [list(shares)[index] for index in member]
    rows: list[dict[str, Any]] = []
    while finished.min() < quota:
        carry, (done, metrics) = chunk(carry)
        done = np.asarray(done)
        metrics = {name: np.asarray(value) for name, value in metrics.items()}
        for t, lot, agent in np.argwhere(done):
            if finished[lot, agent] < quota:
                row = {n: float(value[t, lot, agent]) for n, value in metrics.items()}
                which = {"lot": lot, "agent": agent, "episode": finished[lot, agent]}
                rows.append(
                    {name: float(number) for name, number in which.items()}
                    | complete_row(row, ctrl_dt)
                    | {"family": names[lot]}
                )
            finished[lot, agent] += 1
    rows.sort(key=lambda row: (row["lot"], row["agent"], row["episode"]))
    families = {
        name: summarise([row for row in rows if row["family"] == name], ctrl_dt)
        for name in shares
    }
    return Evaluation(rows, summarise(rows, ctrl_dt), families)


def allot(shares: list[float], num_lots: int) -> np.ndarray:
    """Members (num_lots,) int32 of a mixture's lots, in proportion to their shares.

    The k-th lot goes to the member within whose part of [0, 1] (k + 1/2) / n falls.
    """
    middle = (np.arange(num_lots) + 0.5) / num_lots
    ends = np.cumsum(shares)[:-1]
    return np.searchsorted(ends, middle, side="right").astype(np.int32)


def _chunk(
    env: ParkingEnv, policy: Policy, carry: tuple[State, jax.Array, jax.Array]
) -> tuple[Any, tuple[jax.Array, dict[str, jax.Array]]]:
    def step(carry, _):
        state, observation, key = carry
        key, act_key = jax.random.split(key)
        flat = observation.reshape(-1, observation.shape[-1])
        action, _ = policy(flat, act_key)
        action = action.reshape(*observation.shape[:2], -1)
        state, timestep = jax.vmap(env.step)(state, action)
        return (state, timestep.observation, key), (
            timestep.events.done,
            timestep.metrics,
        )

    return jax.lax.scan(step, carry, None, length=CHUNK)


def summarise(rows: list[dict[str, Any]], ctrl_dt: float) -> dict[str, Any]:
    """Rates with intervals and means of episode rows; times in seconds.

    Where the lot has lanes, `wrong_way_share` is the share of all metres driven that
    went against them. `mean_returns` are those of the reward terms; they add up to
    `mean_return`.
    """
    count = len(rows)

    def rate(name: str) -> dict[str, float]:
        total = sum(row[name] for row in rows)
        low, high = wilson_interval(total, count)
        share = total / count if count else float("nan")
        return {"rate": share, "low": low, "high": high, "count": total}

    def mean(name: str, among: list[dict[str, Any]]) -> float:
        values = [row[name] for row in among]
        return float(np.mean(values)) if values else float("nan")

    parked = [row for row in rows if row["parked"]]
    lanes = {}
    if rows and "wrong_way" in rows[0]:
        path = sum(row["path"] for row in rows)
        wrong = sum(row["wrong_way"] for row in rows)
        lanes["wrong_way_share"] = wrong / path if path else 0.0
    return {
        "episodes": count,
        **{name: rate(name) for name in OUTCOMES + HITS},
        "mean_return": mean("episode_return", rows),
        "mean_returns": {
            name.removeprefix("return_"): mean(name, rows)
            for name in (rows[0] if rows else ())
            if name.startswith("return_")
        },
        "parked_time": mean("length", parked) * ctrl_dt,
        "parked_path": mean("path", parked),
        "parked_gear_changes": mean("gear_changes", parked),
        "parked_distance_error": mean("final_distance", parked),
        "parked_heading_error_deg": math.degrees(mean("final_heading", parked)),
        "parked_speed": mean("final_speed", parked),
        **lanes,
        "metrics": pool_all(rows),
    }


def zero_policy(action: ActionSpec) -> Policy:
    """Takes the middle of every range: stands on the brake, or lets things be."""

    def policy(observation: jax.Array, key: jax.Array):
        del key
        shape = (*observation.shape[:-1], action.size)
        return jnp.broadcast_to(action.middle, shape), {}

    return policy


def random_policy(action: ActionSpec) -> Policy:
    """Draws every number and every index of an action uniformly."""

    def policy(observation: jax.Array, key: jax.Array):
        lead, keys = observation.shape[:-1], (key, key)
        if action.choices:
            keys = jax.random.split(key)
        shape = (*lead, action.continuous)
        numbers = jax.random.uniform(keys[0], shape, minval=-1.0, maxval=1.0)
        counts = jnp.array(action.choices, jnp.int32)
        indices = jax.random.randint(keys[1], (*lead, len(counts)), 0, counts)
        parts = [part.astype(action.dtype) for part in (numbers, indices)]
        return jnp.concatenate(parts, axis=-1), {}

    return policy

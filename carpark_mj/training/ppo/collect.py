"""Collects steps of all agents with the policy in training, and drops absent ones."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from carpark_mj.training.ppo.neighbours import neighbours
from carpark_mj.wrappers.brax import BraxParking

# `(observation, key) -> (action, extras)` with Brax's extras of a stochastic policy.
Actor = Callable[[jax.Array, jax.Array], tuple[jax.Array, dict[str, Any]]]
# Actions (lots * agents, size) in the states of lots.
Teacher = Callable[[Any], jax.Array]


@struct.dataclass
class Rollout:
    """What an update learns from; arrays (time, agents, ...) unless stated.

    Attributes:
        observation: what the agents saw before a step.
        raw_action: actions as drawn, before tanh.
        log_prob: their log-densities under the policy that drew them.
        reward: of the step.
        terminated: 1.0 where the step ended an episode for good.
        truncated: 1.0 where it was cut off, by a timeout for instance.
        final_observation: (agents, size) after the last step.
        weight: 0.0 of steps that are not to be learned from, those of absent agents,
            else 1.0; None = all 1.
        advice: actions of a teacher; None = there is none.
        near: (time, agents, agents of a lot) bool before the step, see `neighbours`;
            None = not asked for.
    """

    observation: jax.Array
    raw_action: jax.Array
    log_prob: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    final_observation: jax.Array
    weight: jax.Array | None = None
    advice: jax.Array | None = None
    near: jax.Array | None = None


@struct.dataclass
class Totals:
    """Sums over the steps of a rollout, (agents,) each.

    Attributes:
        episodes: episodes that ended.
        episode_metrics: sums of their metrics, by name.
        reward_terms: sums over all steps, by name.
    """

    episodes: jax.Array
    episode_metrics: dict[str, jax.Array]
    reward_terms: dict[str, jax.Array]


def collect(
    env: BraxParking,
    env_state: Any,
    actor: Actor,
    key: jax.Array,
    length: int,
    scales: Mapping[str, jax.Array],
    with_neighbours: bool = False,
    teacher: Teacher | None = None,
) -> tuple[Any, Rollout, Totals]:
    """Drives all agents for some steps; returns the state after them as well.

    Args:
        env: all lots.
        env_state: before.
        actor: the policy.
        key: consumed.
        length: steps.
        scales: () factors on reward terms, by name, in the rewards to learn from. What
            is reported has none.
        with_neighbours: whether to give `Rollout.near`.
        teacher: gives `Rollout.advice`.
    """

    def step(carry: Any, key: jax.Array) -> tuple[Any, Any]:
        state, totals = carry
        action, drawn = actor(state.obs, key)
        after = env.step(state, action)
        info = after.info
        done = info["episode_done"]
        ended = {name: x * done for name, x in info["episode_metrics"].items()}
        sums = Totals(done, ended, info["reward_terms"])
        totals = jax.tree.map(jnp.add, totals, sums)
        reward = after.reward + _change(scales, info["reward_terms"])
        taken = (
            state.obs,
            drawn["raw_action"],
            drawn["log_prob"],
            reward,
            done - info["truncation"],
            info["truncation"],
        )
        lots: Any = state.pipeline_state
        advice = teacher(lots) if teacher is not None else None
        near = neighbours(lots) if with_neighbours else None
        return (after, totals), (taken, state.info["present"], advice, near)

    info = env_state.info
    zeros = jax.tree.map(
        jnp.zeros_like,
        Totals(info["episode_done"], info["episode_metrics"], info["reward_terms"]),
    )
    (env_state, totals), (taken, present, advice, near) = jax.lax.scan(
        step, (env_state, zeros), jax.random.split(key, length)
    )
    rollout = Rollout(
        *taken,
        final_observation=env_state.obs,
        weight=present,
        advice=advice,
        near=near,
    )
    return env_state, rollout, totals


def drop_absent(
    rollout: Rollout, count: int, key: jax.Array
) -> tuple[Rollout, jax.Array]:
    """The rollout of fewer agents, absent ones dropped first, and which are kept.

    Where more are present than are kept, some of those are dropped at random.

    Args:
        rollout: with weights; agents that waited for room in some steps count less.
        count: agents to keep.
        key: consumed.
    """
    present = rollout.weight.mean(axis=0) if rollout.weight is not None else 1.0
    luck = jax.random.uniform(key, rollout.reward.shape[1:])
    kept = jnp.argsort(luck - present)[:count]
    final_observation = rollout.final_observation[kept]
    rollout = dataclasses.replace(rollout, final_observation=jnp.zeros(()))
    rollout = jax.tree.map(lambda x: x[:, kept] if x.ndim else x, rollout)
    return dataclasses.replace(rollout, final_observation=final_observation), kept


def _change(
    scales: Mapping[str, jax.Array], terms: Mapping[str, jax.Array]
) -> jax.Array:
    """What factors on reward terms (agents,) add to their sum."""
    changes = [(scale - 1.0) * terms[name] for name, scale in scales.items()]
    return sum(changes, jnp.zeros(()))

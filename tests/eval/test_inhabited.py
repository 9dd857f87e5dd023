"""The long run among people counts what is not finite."""

import types
from typing import NamedTuple

import jax
import jax.numpy as jnp
from helpers.transitions import no_events

from carpark_mj.types import Events
from inhabited import FOUND, make_round


class Step(NamedTuple):
    """What the round reads of a `TimeStep`."""

    reward: jax.Array
    events: Events


class Failing:
    """Two agents; in some lots a number is not finite in the seventh step alone."""

    num_agents = 2
    action_spec = types.SimpleNamespace(size=2)

    def reset(self, key):
        state = {"x": jnp.zeros(2), "step": jnp.int32(0), "key": key}
        return state, jnp.zeros((2, 3))

    def step(self, state, action):
        step = state["step"] + 1
        fails = jax.random.bernoulli(state["key"]) & (step == 7)
        state = state | {"x": action[:, 0], "step": step}
        events = no_events(2, parked=[True, False], diverged=[step == 3, False])
        return state, Step(jnp.where(fails, jnp.inf, action[:, 1]), events)


def test_lots_are_counted_once_and_events_every_time():
    env, key, lots = Failing(), jax.random.key(0), 64
    counts = dict(zip(FOUND, make_round(env, lots, 20)(key).tolist(), strict=True))
    starts = jax.random.split(jax.random.split(key)[0], lots)
    bad = int(jax.vmap(jax.random.bernoulli)(starts).sum())
    assert 0 < bad < lots
    none = dict.fromkeys(FOUND, 0)
    assert counts == none | {"not finite": bad, "diverged": lots, "parked": 20 * lots}
    counts = make_round(env, lots, 5)(key).tolist()
    assert counts == [0, lots, 0, 0, 5 * lots]

"""Shares of the neighbours' rewards: whose they are, and what is learned from."""

from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State as BraxState
from flax import struct

from carpark_mj.training.ppo import learner as learner_module
from carpark_mj.training.ppo.collect import collect
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.curriculum import SHARE_RISES, neighbour_share
from carpark_mj.training.ppo.curriculum_config import CurriculumConfig
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.neighbours import RANGE, neighbours_mean


@struct.dataclass
class Lots:
    """All that is read of lots: where their agents (lots, agents) are, if they are."""

    xy: jax.Array
    active: jax.Array

    @property
    def motion(self):
        return self


def lots(xy, active=None) -> Any:
    """Lots whose agents stand at `xy` (lots, agents, 2)."""
    xy = jnp.asarray(xy, jnp.float32)
    active = jnp.ones(xy.shape[:2], bool) if active is None else active
    return Lots(xy, jnp.asarray(active))


def mean(xy, reward, active=None):
    """`neighbours_mean` of one lot with agents on a line, at `xy` metres."""
    xy = np.stack([xy, np.zeros(len(xy))], axis=-1)[None]
    active = None if active is None else np.array([active])
    return np.asarray(neighbours_mean(lots(xy, active), jnp.float32(reward)))


def test_two_share_within_the_range_and_not_beyond():
    np.testing.assert_array_equal(mean([0.0, RANGE - 0.1], [1.0, -2.0]), [-2.0, 1.0])
    np.testing.assert_array_equal(mean([0.0, RANGE + 0.1], [1.0, -2.0]), [0.0, 0.0])


def test_the_mean_is_of_those_nearby_that_are_present():
    # At 20 m the last is a neighbour of the second and the third only.
    at, paid = [0.0, 6.0, 8.0, 20.0], [1.0, 2.0, 3.0, 6.0]
    np.testing.assert_allclose(mean(at, paid), [2.5, 10 / 3, 3.0, 2.5])
    # An absent one neither gives nor gets, wherever it stands.
    there = [True, True, False, True]
    np.testing.assert_allclose(mean(at, paid, there), [2.0, 3.5, 0.0, 2.0])


def test_lots_do_not_mix_and_the_order_of_agents_does_not_matter():
    rng = np.random.default_rng(0)
    xy, reward = rng.uniform(0, 20, (5, 6, 2)), rng.normal(size=(5, 6))
    active = rng.random((5, 6)) < 0.8

    def found(lot, order):
        chosen = np.ix_(lot, order)
        given = lots(xy[chosen], active[chosen]), jnp.float32(reward[chosen].ravel())
        return np.asarray(neighbours_mean(*given)).reshape(len(lot), len(order))

    same, every = np.arange(6), found(np.arange(5), np.arange(6))
    assert (every != 0.0).any(axis=1).all()
    for lot in range(5):
        np.testing.assert_array_equal(found([lot], same)[0], every[lot])
    order = rng.permutation(6)
    np.testing.assert_allclose(
        found(np.arange(5), order), every[:, order], rtol=1e-5, atol=1e-6
    )


def test_the_share_rises_from_nothing_and_stays_at_its_end():
    config, (start, end) = CurriculumConfig(neighbour_share=0.5), SHARE_RISES
    progress = jnp.array([0.0, start, (start + end) / 2, end, 1.0])
    found = neighbour_share(config, progress)
    np.testing.assert_allclose(cast(Any, found), [0, 0, 0.25, 0.5, 0.5], atol=1e-6)
    assert neighbour_share(CurriculumConfig(), progress) is None


@pytest.mark.parametrize(("done", "expected"), [(0.0, 0.0), (0.4, 0.25), (1.0, 0.5)])
def test_a_training_shares_by_its_progress(monkeypatch, done, expected):
    def told(*given, **more):
        return more["neighbour_share"]

    monkeypatch.setattr(learner_module, "collect", told)
    monkeypatch.setattr(learner_module, "make_policy", lambda *given, **more: None)
    config = PPOConfig(
        num_steps=6_400_000, curriculum=CurriculumConfig(neighbour_share=0.5)
    )
    update = jnp.int32(done * config.num_updates)
    state = SimpleNamespace(
        update=update, seconds=0.0, normalizer=None, policy=None, env=None
    )
    share: Any = Learner(config)._collect(cast(Any, state), jax.random.key(0))
    assert share == pytest.approx(expected, abs=5e-3)  # whole updates


class Parting:
    """Two agents 5 m apart go 20 m apart and stay there; every step pays the same."""

    paid = jnp.array([1.0, -2.0])

    def step(self, state, action):
        del action
        xy = jnp.array([[[0.0, 0.0], [20.0, 0.0]]])
        info = state.info | {"reward_terms": {"paid": self.paid}}
        return state.replace(pipeline_state=lots(xy), reward=self.paid, info=info)


@pytest.mark.parametrize("share", [None, 0.0, 0.5])
def test_rewards_to_learn_from_are_shared_by_where_agents_were_before_the_step(share):
    zero = jnp.zeros(2)
    info = {
        "truncation": zero,
        "episode_done": zero,
        "present": jnp.ones(2),
        "episode_metrics": {},
        "reward_terms": {"paid": zero},
    }
    state = BraxState(
        lots([[[0.0, 0.0], [5.0, 0.0]]]), jnp.zeros((2, 1)), zero, zero, {}, info
    )

    def act(observation, key):
        del key
        return observation, {"raw_action": observation, "log_prob": zero}

    given = None if share is None else jnp.float32(share)
    key = jax.random.key(0)
    _, rollout, totals = collect(cast(Any, Parting()), state, act, key, 2, {}, given)
    near = (share or 0.0) * np.array([-2.0, 1.0])
    np.testing.assert_array_equal(rollout.reward, [Parting.paid + near, Parting.paid])
    # What is reported knows nothing of it.
    np.testing.assert_array_equal(totals.reward_terms["paid"], 2 * Parting.paid)

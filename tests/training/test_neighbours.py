"""Shares of the neighbours' advantages: whose they are, and what is learned from."""

from types import SimpleNamespace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from brax.envs.base import State as BraxState
from flax import struct
from helpers.learning import begun, rollout

from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo import learn as epochs
from carpark_mj.training.ppo.collect import (
    RANGE,
    collect,
    compute_advantages,
    neighbours,
    neighbours_mean,
)
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import SHARE_RISES, neighbour_share
from carpark_mj.training.ppo.learner import Learner


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


def mean(xy, values, active=None):
    """`neighbours_mean` of one lot with agents on a line, at `xy` metres."""
    xy = np.stack([xy, np.zeros(len(xy))], axis=-1)[None]
    active = None if active is None else np.array([active])
    near = neighbours(lots(xy, active))
    return np.asarray(neighbours_mean(near[None], jnp.float32(values)[None]))[0]


def test_the_mean_is_of_those_nearby_that_are_present():
    np.testing.assert_array_equal(mean([0.0, RANGE - 0.1], [1.0, -2.0]), [-2.0, 1.0])
    np.testing.assert_array_equal(mean([0.0, RANGE + 0.1], [1.0, -2.0]), [0.0, 0.0])
    # At 20 m the last is a neighbour of the second and the third only.
    at, worth = [0.0, 6.0, 8.0, 20.0], [1.0, 2.0, 3.0, 6.0]
    np.testing.assert_allclose(mean(at, worth), [2.5, 10 / 3, 3.0, 2.5])
    # An absent one neither gives nor gets, wherever it stands.
    there = [True, True, False, True]
    np.testing.assert_allclose(mean(at, worth, there), [2.0, 3.5, 0.0, 2.0])


def test_lots_do_not_mix_and_the_order_of_agents_does_not_matter():
    rng = np.random.default_rng(0)
    xy, values = rng.uniform(0, 20, (5, 6, 2)), rng.normal(size=(5, 6))
    active = rng.random((5, 6)) < 0.8

    def found(lot, order):
        chosen = np.ix_(lot, order)
        near = neighbours(lots(xy[chosen], active[chosen]))
        given = near[None], jnp.float32(values[chosen].reshape(1, -1))
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


class Parting:
    """Two agents 5 m apart go 20 m apart and stay there."""

    def step(self, state, action):
        del action
        return state.replace(pipeline_state=lots([[[0.0, 0.0], [20.0, 0.0]]]))


def test_neighbours_are_those_from_before_the_step():
    zero = jnp.zeros(2)
    info = {
        "truncation": zero,
        "episode_done": zero,
        "present": jnp.ones(2),
        "episode_metrics": {},
        "reward_terms": {},
    }
    state = BraxState(
        lots([[[0.0, 0.0], [5.0, 0.0]]]), jnp.zeros((2, 1)), zero, zero, {}, info
    )

    def act(observation, key):
        del key
        return observation, {"raw_action": observation, "log_prob": zero}

    def collected(**more):
        key = jax.random.key(0)
        return collect(cast(Any, Parting()), state, act, key, 2, {}, **more)[1].near

    near = collected(with_neighbours=True)
    np.testing.assert_array_equal(near, [[[0, 1], [1, 0]], [[0, 0], [0, 0]]])
    assert collected() is None


LOTS, AGENTS, TIME = 6, 3, 4


def learned(monkeypatch, share, near, weight, reward=None, done=1.0):
    """Advantages with the share, and those of each alone, (time, kept), and weights.

    Rewards (time,) are those of all agents; None = at random. `done` is the progress.
    """
    config = PPOConfig(
        num_steps=1_000_000,
        num_lots=LOTS,
        num_minibatches=1,
        num_epochs=1,
        unroll_length=TIME,
        env=EnvConfig(num_agents=AGENTS, min_agents=1),
        curriculum=CurriculumConfig(neighbour_share=share),
        networks=NetworkConfig((4,), (4,), encoder="flat"),
    )
    learner, update = Learner(config), int(done * config.num_updates)
    parts = learner.networks, learner.inputs
    count = LOTS * AGENTS
    drawn = np.random.default_rng(1).normal(size=(TIME, count))
    reward = drawn if reward is None else np.tile(reward[:, None], count)
    more = {"reward": jnp.float32(reward), "weight": weight, "near": near}
    steps, found = rollout((TIME, count), learner.inputs.size, **more), []

    def watched(*given):
        found.append(compute_advantages(*given))
        return found[-1]

    def prepared(prepare, params, *others):
        del others
        found.append(prepare(params))
        raise StopIteration

    monkeypatch.setattr(epochs, "compute_advantages", watched)
    stopped = SimpleNamespace(normalizes=0, prepared=prepared)
    monkeypatch.setattr(epochs, "VARIANTS", {config.variant: stopped})
    given = begun(*parts, jax.random.key(0), update), steps, jax.random.key(2)
    with pytest.raises(StopIteration):
        epochs.learn(config, *parts, learner.optimizer, *given)
    (own, targets), steps = found
    np.testing.assert_array_equal(steps.target, targets)  # the critic's are its own
    return np.asarray(steps.advantage), np.asarray(own), np.asarray(steps.weight)


@pytest.mark.parametrize(("done", "part"), [(0.0, 0.0), (0.4, 0.25), (1.0, 0.5)])
def test_advantages_have_the_share_of_the_progress(monkeypatch, done, part):
    all_near = jnp.ones((TIME, LOTS * AGENTS, AGENTS), bool)
    near = all_near & ~jnp.tile(jnp.eye(AGENTS, dtype=bool), (LOTS, 1))
    together, own, _ = learned(monkeypatch, 0.5, near, None, done=done)
    lot = own.reshape(TIME, LOTS, AGENTS)
    theirs = (lot.sum(axis=-1, keepdims=True) - lot) / (AGENTS - 1)
    expected = own + part * theirs.reshape(own.shape)
    np.testing.assert_allclose(together, expected, atol=5e-3)  # whole updates
    together, own, _ = learned(monkeypatch, 0.0, None, None)  # without a share
    np.testing.assert_array_equal(together, own)


def test_shares_are_of_the_own_lot_if_absent_are_dropped(monkeypatch):
    """The agents kept are in another order; one of three is absent in every lot."""
    present = np.ones((LOTS, AGENTS), bool)
    present[np.arange(LOTS), np.arange(LOTS) % AGENTS] = False
    both = present[:, :, None] & present[:, None] & ~np.eye(AGENTS, dtype=bool)
    near = jnp.broadcast_to(
        jnp.asarray(both.reshape(-1, AGENTS)), (TIME, LOTS * AGENTS, AGENTS)
    )
    weight = jnp.broadcast_to(jnp.float32(present.ravel()), near.shape[:2])
    together, own, kept = learned(monkeypatch, 1.0, near, weight)
    assert kept[0].sum() == present.sum()  # nobody present was dropped
    # With the whole share two that are near learn from the same.
    shared, alone = together[0, kept[0] > 0], own[0, kept[0] > 0]
    assert len(np.unique(shared.round(4))) == LOTS
    assert len(np.unique(alone.round(4))) == present.sum()
    np.testing.assert_allclose(shared.sum(), 2 * alone.sum(), rtol=1e-4)


def test_the_mean_is_of_those_that_are_kept(monkeypatch):
    """All are alike, so the mean is the own advantage, or 0 where all are dropped."""
    others = ~jnp.tile(jnp.eye(AGENTS, dtype=bool), (LOTS, 1))
    near = jnp.broadcast_to(others, (TIME, *others.shape))
    weight = jnp.ones(near.shape[:2])
    reward = np.arange(1.0, TIME + 1.0)
    together, own, _ = learned(monkeypatch, 1.0, near, weight, reward)
    assert own.shape[1] < LOTS * AGENTS
    share = together / own - 1.0
    np.testing.assert_allclose(share, share.round(), atol=1e-4)
    assert share.max() == pytest.approx(1.0)

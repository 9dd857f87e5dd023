"""What is learned from others: shares of neighbours' advantages, and teachers."""

import dataclasses
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from helpers.learning import SMALL, begun, rollout, unrolled

from carpark_mj.config import EnvConfig, RayConfig, RingConfig, insert
from carpark_mj.env import ParkingEnv
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import ContinuousObservation
from carpark_mj.observations.compose import ObservationSets
from carpark_mj.observations.fields import Field
from carpark_mj.policy.networks import NetworkConfig, init_normalizer, make_networks
from carpark_mj.training.ppo import learn as epochs
from carpark_mj.training.ppo import learner as learners
from carpark_mj.training.ppo import warm_start as teachers
from carpark_mj.training.ppo.collect import (
    AXIS,
    RANGE,
    compute_advantages,
    neighbours,
    neighbours_mean,
)
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learn import (
    SHARE_RISES,
    neighbour_share,
    network_params,
    teacher_cost,
)
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.ppo.variants import Minibatch, Weights, ppo_loss
from carpark_mj.training.ppo.warm_start import make_teacher


@struct.dataclass
class Lots:
    """All that is read of lots: where their agents (lots, agents) are, if they are."""

    xy: jax.Array
    active: jax.Array

    @property
    def motion(self):
        return self


def lots(xy, active=None):
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


def test_the_share_rises_from_nothing_and_stays_at_its_end():
    config, (start, end) = CurriculumConfig(neighbour_share=0.5), SHARE_RISES
    progress = jnp.array([0.0, start, (start + end) / 2, end, 1.0])
    found = neighbour_share(config, progress)
    np.testing.assert_allclose(found, [0, 0, 0.25, 0.5, 0.5], atol=1e-6)
    assert neighbour_share(CurriculumConfig(), progress) is None


class Parting:
    """Two agents 5 m apart go 20 m apart and stay there."""

    def step(self, state, action):
        return state.replace(pipeline_state=lots([[[0.0, 0.0], [20.0, 0.0]]]))


def test_neighbours_are_those_from_before_the_step():
    start = lots([[[0.0, 0.0], [5.0, 0.0]]])
    near = unrolled(Parting(), start, 2, 2, with_neighbours=True).near
    np.testing.assert_array_equal(near, [[[0, 1], [1, 0]], [[0, 0], [0, 0]]])
    assert unrolled(Parting(), start, 2, 2).near is None


LOTS, AGENTS, TIME = 6, 3, 4


def learned(monkeypatch, share, near, weight, reward=None, done=1.0):
    """Advantages with the share, and those of each alone, (time, kept), and weights.

    Rewards (time,) are those of all agents; None = at random. `done` is the progress.
    """
    size = {"num_steps": 1_000_000, "num_lots": LOTS, "unroll_length": TIME}
    size |= {"env.num_agents": AGENTS, "env.min_agents": 1}
    config = insert(SMALL, size | {"curriculum.neighbour_share": share})
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
        found.append(prepare(params))
        raise StopIteration

    monkeypatch.setattr(epochs.collect, "compute_advantages", watched)
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


BLIND = ContinuousObservation(1, 1, rings=RingConfig(), rays=RayConfig())
KNOWS = dataclasses.replace(BLIND, lines=True)
TAUGHT = CurriculumConfig(teacher="somebody")
CONFIG = PPOConfig(
    curriculum=TAUGHT,
    env=EnvConfig(
        num_agents=2, num_parked_cars=1, physics="bicycle", observation=BLIND
    ),
)


def knows(monkeypatch, observation):
    """A teacher whose action is the end of its observation."""

    def load(name, env=None):
        assert name == "somebody"
        return SimpleNamespace(
            env=env or dataclasses.replace(CONFIG.env, observation=observation),
            policy=lambda seen, key: (seen[:, -2:], {}),
        )

    monkeypatch.setattr(teachers, "load_policy", load)


def test_a_teacher_acts_on_its_own_observation_of_the_same_lots(monkeypatch):
    knows(monkeypatch, KNOWS)
    teacher = make_teacher(CONFIG)
    assert teacher is not None
    env = ParkingEnv(dataclasses.replace(CONFIG.env, observation=KNOWS))

    def look(keys):
        lots, seen = jax.vmap(env.reset)(keys)
        return teacher(lots), seen

    advice, seen = jax.jit(look)(jax.random.split(jax.random.key(0), 3))
    np.testing.assert_allclose(advice, seen.reshape(6, -1)[:, -2:], atol=1e-6)
    assert np.std(advice) > 0.0


def collected(monkeypatch, config):
    """The options with which a training collects, and its learner."""
    monkeypatch.setattr(learners, "collect", lambda *given, **more: more)
    monkeypatch.setattr(learners, "make_policy", lambda *given, **more: None)
    names = ("normalizer", "policy", "env")
    state = SimpleNamespace(update=jnp.int32(0), seconds=0.0, **dict.fromkeys(names))
    learner = learners.Learner(config)
    found = learner._collect(state, jax.random.key(0))
    return found, learner


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_training_collects_with_its_teacher_and_neighbours(monkeypatch, share):
    knows(monkeypatch, KNOWS)
    curriculum = dataclasses.replace(TAUGHT, neighbour_share=share)
    config = dataclasses.replace(CONFIG, curriculum=curriculum)
    more, learner = collected(monkeypatch, config)
    assert learner.teacher is not None
    assert more["teacher"] is learner.teacher
    assert more["with_neighbours"] == (share > 0.0)


def test_a_teacher_s_weight_falls_to_zero_and_none_has_none():
    config = dataclasses.replace(TAUGHT, teacher_cost=4.0, teacher_until=0.5)
    progress = jnp.array([0.0, 0.125, 0.5, 0.9])
    found = jnp.stack([jnp.asarray(teacher_cost(config, x)) for x in progress])
    np.testing.assert_allclose(found, [4.0, 3.0, 0.0, 0.0], atol=1e-6)
    assert make_teacher(PPOConfig()) is None
    assert teacher_cost(CurriculumConfig(), jnp.float32(0.0)) is None


def test_the_loss_counts_the_distance_of_modes_by_weight():
    networks = make_networks(
        NetworkConfig((4,), (4,), encoder="flat"),
        [Field("x", 3, -1.0, 1.0, "")],
        ActionSpec(2),
    )

    def losses(key):
        keys = jax.random.split(key, 5)
        seen, raw = jax.random.normal(keys[0], (6, 3)), jnp.ones((6, 2))
        policy = networks.policy_network.init(keys[1])
        params = network_params(policy, networks.value_network.init(keys[2]))
        advice = jax.random.uniform(keys[3], (6, 2), minval=-1.0)
        weight = jnp.array([1.0, 0.0, 1.0, 0.0, 1.0, 1.0])
        steps = Minibatch(seen, raw, -weight, weight, weight, weight, advice)
        weights = Weights(jnp.float32(0.1), jnp.float32(0.2), jnp.float32(3.0))
        normalizer = init_normalizer(ObservationSets(3))
        given = (params, networks, normalizer)
        alone = dataclasses.replace(steps, advice=None)
        totals = [
            ppo_loss(*given, batch, weights, keys[4])[0] for batch in (steps, alone)
        ]
        logits = networks.policy_network.apply(normalizer, policy, seen)
        distribution = networks.parametric_action_distribution
        return totals, distribution.mode(logits), advice, weight

    key = jax.random.split(jax.random.key(1), 1)
    found = jax.jit(jax.vmap(losses, axis_name=AXIS))(key)
    (taught, alone), mode, advice, weight = jax.tree.map(lambda x: x[0], found)
    distance = (np.square(mode - advice).sum(axis=-1) * weight).sum() / weight.sum()
    assert float(taught - alone) == pytest.approx(3.0 * float(distance), rel=1e-4)

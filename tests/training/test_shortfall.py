"""Families drawn by shortfall: rates, weights, and the lots that training gets."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import POSES, SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts import StreetConfig, layout_config
from carpark_mj.layouts.registry import mixture
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training.ppo.collect import (
    MEMORY,
    Families,
    Totals,
    make_families,
)
from carpark_mj.training.ppo.config import CurriculumConfig, PPOConfig
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.wrappers.brax import BraxParking

THREE = Families(0.9, {"lot": 0.5, "street": 0.25, "angled": 0.25}, range(2, 3))
# Pairs, in this order: lot 1, lot 2, street 1, street 2.
PAIRS = Families(0.9, {"lot": 0.75, "street": 0.25}, range(1, 3))
STREETS = mixture(
    [StreetConfig(bays_per_side=(3, 3)), StreetConfig(bays_per_side=(5, 5))]
)
CONFIG = PPOConfig(
    num_lots=6,
    lot_life=3,
    unroll_length=5,
    num_minibatches=1,
    num_epochs=1,
    networks=NetworkConfig((8,), (8,)),
    curriculum=CurriculumConfig(target_rate=0.9),
    env=EnvConfig(
        layout=STREETS,
        physics="bicycle",
        observation=POSES,
        num_agents=2,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=2),  # every episode ends within an unroll
    ),
)


@pytest.mark.parametrize(
    ("rates", "expected"),
    [
        # Nothing known, all alike: half by share, half uniform.
        ((0.0, 0.0, 0.0), (5 / 12, 7 / 24, 7 / 24)),
        # Shortfalls 0.0, 0.1 and 0.3: half of 0, 1/4, 3/4.
        ((0.95, 0.8, 0.6), (0.25, 0.25, 0.5)),
        ((0.9, 0.95, 1.0), (0.5, 0.25, 0.25)),
    ],
)
def test_probabilities_are_half_by_share_half_by_shortfall(rates, expected):
    np.testing.assert_allclose(THREE.probabilities(jnp.array(rates)), expected, 1e-5)


def updated(rates, member, episodes, parked):
    """Rates after an unroll of agents (devices, n) in three members."""

    def update(member, episodes, parked):
        totals = Totals(episodes, {"parked": parked}, {})
        return THREE.update(jnp.array(rates), {"member": member}, totals, "devices")

    numbers = (jnp.asarray(x, jnp.float32) for x in (episodes, parked))
    after = jax.vmap(update, axis_name="devices")(jnp.asarray(member), *numbers)
    np.testing.assert_array_equal(after, np.broadcast_to(after[0], after.shape))
    return after[0]


def test_rates_are_running_means_by_episodes_of_each_member():
    after = updated(
        (0.5, 0.5, 0.2),
        member=[[0, 1], [0, 1]],
        episodes=[[3.0, 2.0], [1.0, 0.0]],
        parked=[[2.0, 0.0], [1.0, 0.0]],
    )
    old = (1 - 1 / MEMORY) ** np.array([4.0, 2.0])
    expected = [*(old * 0.5 + (1 - old) * (0.75, 0.0)), 0.2]
    np.testing.assert_allclose(after, expected, rtol=1e-5)
    # So many episodes leave nothing of what was before.
    far = updated((0.5, 0.5, 0.2), [[2]], [[20 * MEMORY]], [[5 * MEMORY]])
    np.testing.assert_allclose(far, [0.5, 0.5, 0.25], atol=1e-6)


def test_pairs_are_drawn_half_by_their_shortfall():
    rates = jnp.array([0.9, 0.8, 0.95, 0.6])
    # By share 3/8, 3/8, 1/8, 1/8; shortfalls 0, 0.1, 0 and 0.3.
    expected = np.array([3 / 16, 3 / 16 + 1 / 8, 1 / 16, 1 / 16 + 3 / 8])
    np.testing.assert_allclose(PAIRS.probabilities(rates), expected, rtol=1e-5)
    _, member, present = PAIRS.draw(rates, jax.random.key(0), 4000)
    pair = 2 * np.asarray(member) + np.asarray(present) - 1
    share = np.bincount(pair, minlength=4) / 4000
    np.testing.assert_allclose(share, expected, atol=0.04)  # five deviations


def test_rates_of_pairs_are_reported_as_means():
    many = 20 * MEMORY  # episodes that leave nothing of what was before
    parked = jnp.array([0.1, 0.2, 0.3, 0.4]) * many
    totals = Totals(jnp.full(4, many), {"parked": parked}, {})
    info = {"member": jnp.array([1, 0, 0, 1]), "num_present": jnp.array([2, 2, 1, 1])}
    update = jax.vmap(PAIRS.update, (0, None, None, None), axis_name="devices")
    (rates,) = update(PAIRS.init()[None], info, totals, "devices")
    np.testing.assert_allclose(rates, [0.3, 0.2, 0.4, 0.1], atol=1e-6)
    found = PAIRS.metrics(rates)
    expected = {"family/lot": 0.25, "family/street": 0.25}
    expected |= {"agents/1": 0.35, "agents/2": 0.15}
    assert found == pytest.approx(expected)


def test_new_lots_have_the_numbers_of_agents_drawn():
    config = dataclasses.replace(CONFIG.env, num_agents=3, min_agents=1)
    env = BraxParking(ParkingEnv(config, SlidePhysics()))
    keys, member = jax.random.split(jax.random.key(0), 4), jnp.array([0, 1, 1, 0])

    def run():
        state = env.reset(keys, member, jnp.array([3, 1, 2, 1]))
        lots, numbers = jnp.array([2, 0]), jnp.array([3, 2])
        return state, env.renew(state, lots, keys[:2], member[:2], numbers)

    begun, renewed = jax.jit(run)()
    for state, expected in ((begun, [3, 1, 2, 1]), (renewed, [2, 1, 3, 1])):
        present = np.asarray(state.pipeline_state.takes_part)
        np.testing.assert_array_equal(present.sum(axis=1), expected)
        np.testing.assert_array_equal(state.info["num_present"], np.repeat(expected, 3))


def test_one_family_is_drawn_by_its_numbers_of_agents():
    def probabilities(counts, rates):
        families = make_families(0.9, layout_config("street"), counts)
        return families.probabilities(jnp.array(rates))

    np.testing.assert_allclose(probabilities(range(1, 2), [0.5]), [1.0])
    # Half uniform, half by shortfalls of 0.1 and 0.3.
    many = probabilities(range(1, 3), [0.8, 0.6])
    np.testing.assert_allclose(many, [0.25 + 0.125, 0.25 + 0.375], rtol=1e-5)


@functools.cache
def learner():
    learner = Learner(CONFIG)
    learner.env = BraxParking(ParkingEnv(CONFIG.env, SlidePhysics()))
    return learner, learner.compile()


def bays(state):
    """Numbers of bays of the lots, which tell the two members apart."""
    return np.asarray(state.env.pipeline_state.layout.bay_mask).sum(axis=1)


@pytest.mark.slow
def test_the_member_kept_for_every_agent_is_that_of_its_lot():
    learner_, update = learner()
    state = learner_.init()
    for _ in range(4):
        member = np.asarray(state.env.info["member"]).reshape(6, 2)
        np.testing.assert_array_equal(member[:, 0], member[:, 1])
        np.testing.assert_array_equal(bays(state), np.where(member[:, 0], 10, 6))
        state, metrics = update(state)
    assert set(metrics) >= {"family/street", "family/street 2"}
    rates = [float(metrics[f"family/{name}"]) for name in ("street", "street 2")]
    np.testing.assert_array_equal(rates, state.family_rates)


def test_the_family_that_falls_short_gets_more_lots():
    """The other one has reached the target: of its lots only half of its share."""
    families = make_families(0.9, STREETS, range(2, 3))
    env = ParkingEnv(CONFIG.env, SlidePhysics())

    @jax.jit
    def draw(rates):
        keys, member, present = families.draw(rates, jax.random.key(3), 400)
        assert present is None  # all lots have two agents
        lots = jax.vmap(lambda key, member: env.draw_layout(key, "train", member))
        return lots(keys, member).bay_mask

    # Deviation 2.2 %: four and a half of them.
    for rates, share in (([0.95, 0.1], 0.75), ([0.1, 0.95], 0.25)):
        found = np.asarray(draw(jnp.array(rates))).sum(axis=1) == 10
        assert found.mean() == pytest.approx(share, abs=0.1)


def test_without_a_target_lots_are_drawn_with_the_keys_of_before():
    families, key = make_families(0.0, STREETS, range(1, 9)), jax.random.key(5)
    keys, member, present = families.draw(families.init(), key, 3)
    assert member is None
    assert present is None
    np.testing.assert_array_equal(
        jax.random.key_data(keys), jax.random.key_data(jax.random.split(key, 3))
    )
    assert families.metrics(families.init()) == {}

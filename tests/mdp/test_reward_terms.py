"""Reward terms that other code registers."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.paying import GOAL, events, step, terms
from helpers.scenes import cars

from carpark_mj.config import (
    REWARD_TERMS,
    EnvConfig,
    RewardConfig,
    RewardTerm,
    insert,
    is_data,
)
from carpark_mj.mdp.rewards import TERMS, reward_terms
from carpark_mj.policy.runs import from_dict
from carpark_mj.training.ppo.group import make_learner, program
from carpark_mj.training.ppo.parts import PRESETS

CALLS = []


def hurry(config, transition, above=1.5, kind=0.0):
    """Speed above a limit."""
    CALLS.append(kind)
    return jnp.maximum(transition.after.motion.speed - above, 0.0)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Two terms that are gone after each test."""
    term = RewardTerm(hurry, sign=-1, per_step=True, fixed=("kind",))
    monkeypatch.setitem(REWARD_TERMS._parts, "hurry", term)
    bonus = RewardTerm(lambda config, step: jnp.ones_like(step.after.motion.speed))
    monkeypatch.setitem(REWARD_TERMS._parts, "bonus", bonus)
    CALLS.clear()


def paid(extra):
    before, after = (cars([(0.0, 0.0, 0.0)] * 2, speed=v) for v in ([0, 0], [1.0, 3.5]))
    return terms(RewardConfig(extra=extra), before, after, GOAL)


def test_a_term_pays_its_weight_its_sign_and_a_share_of_a_step():
    got = paid({"bonus": 0.25, "hurry": 10.0})
    assert tuple(got) == (*TERMS, "bonus", "hurry")  # in the order they are given
    np.testing.assert_allclose(got["bonus"], [0.25, 0.25])
    np.testing.assert_allclose(got["hurry"], [0.0, -10.0 / 200 * 2.0], atol=1e-7)


def test_parameters_are_those_of_the_config():
    got = paid({"hurry": 10.0, "hurry.above": 0.5, "hurry.kind": 2})
    np.testing.assert_allclose(got["hurry"], [-0.025, -0.15], atol=1e-7)
    assert CALLS == [2]


@pytest.mark.parametrize("extra", [{}, {"hurry": 0.0}])
def test_a_term_that_weighs_nothing_is_not_computed(extra):
    np.testing.assert_array_equal(paid(extra).get("hurry", 0.0), 0.0)
    assert not CALLS


def test_a_term_with_a_traced_weight_is_computed_even_where_it_is_0():
    reward = RewardConfig(extra={"hurry": 0.0, "hurry.above": 1.5})
    config = EnvConfig(num_agents=2, reward=reward)
    car = cars([(0.0, 0.0, 0.0)] * 2, speed=3.5)

    @jax.jit
    def pay(weight, above):
        values = {"reward.extra.hurry": weight, "reward.extra.hurry.above": above}
        traced = insert(config, values)
        return reward_terms(traced, step(config, car, car))["hurry"]

    for weight, above in ((0.0, 1.5), (2.0, 1.5), (2.0, 3.0)):
        expected = [-weight / 200 * (3.5 - above)] * 2
        np.testing.assert_allclose(pay(weight, above), expected, atol=1e-7)
    assert len(CALLS) == 1


def test_agents_whose_episodes_are_over_are_not_paid():
    config = EnvConfig(num_agents=2, reward=RewardConfig(extra={"bonus": 1.0}))
    car = cars([(0.0, 0.0, 0.0)] * 2)
    happened = step(config, car, car, happened=events(2, diverged=[0]))
    assert reward_terms(config, happened)["bonus"].tolist() == [0.0, 1.0]


def test_settings_come_back_from_json_in_their_order():
    reward = RewardConfig(extra={"hurry.above": 2.0, "hurry": 1.0, "bonus": 3.0})
    stored = json.loads(json.dumps(dataclasses.asdict(reward)))
    found = from_dict(RewardConfig, stored)
    assert found == reward
    assert hash(found) == hash(reward)
    assert found != RewardConfig(extra=dict(sorted(reward.extra.items())))


def test_what_may_be_traced_is_a_property_of_the_term():
    extra = {"hurry": 1.0, "hurry.above": 2.0, "hurry.kind": 1.0}
    config = EnvConfig(reward=RewardConfig(extra=extra))
    data = [name for name in extra if is_data(config, f"reward.extra.{name}")]
    assert data == ["hurry", "hurry.above"]


def test_runs_side_by_side_differ_in_a_term_as_far_as_it_says():
    def run(**changes):
        extra = {"hurry": 1.0, "hurry.above": 2.0, "hurry.kind": 1.0} | changes
        config = PRESETS["cpu"]
        return insert(config, {"env.reward": RewardConfig(extra=extra)})

    assert program(run()) == program(run(hurry=2.0, **{"hurry.above": 1.0}))
    with pytest.raises(ValueError, match=r"the same env\.reward\.extra\.hurry\.kind"):
        make_learner([run(), run(**{"hurry.kind": 2.0})])

"""Lots that have few bays for the agents there could be: they have fewer agents."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig, FleetConfig, RayConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import evaluate
from carpark_mj.layouts import StreetConfig, layout_config, mixture
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.named import random_policy
from carpark_mj.spawning.checks import check_numbers
from carpark_mj.types import NO_BAY

MOST, LOTS = 7, 48
CONFIG = EnvConfig(  # streets of 4 and of 10 bays
    layout=mixture(
        [StreetConfig(bays_per_side=(2, 2)), StreetConfig(bays_per_side=(5, 5))]
    ),
    num_agents=MOST,
    min_agents=2,
    num_parked_cars=8,
    occupancy=(0.5, 0.8),
    episode=EpisodeConfig(max_steps=4),
    observation=ContinuousObservation(rays=RayConfig()),
)
MEMBER = np.arange(LOTS) % 2
WANTED = np.arange(LOTS) // 2 % (MOST + 1)  # 0 stands for a number drawn by the lot


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(CONFIG, SlidePhysics())


@pytest.fixture(scope="module")
def lots(env):
    """Starts with two to seven agents asked for, and with drawn numbers of them."""
    keys, member = jax.random.split(jax.random.key(0), LOTS), jnp.asarray(MEMBER)
    asked = jnp.clip(WANTED, 2, MOST).astype(jnp.int32)

    def start(key, member, asked):
        return env.reset(key, "train", member, asked)[0]

    return jax.device_get(
        jax.jit(
            lambda: jax.vmap(start)(keys, member, asked).replace(key=jnp.zeros(LOTS))
        )()
    )


def test_a_lot_has_an_agent_for_every_two_bays_at_most_and_they_are_the_first(lots):
    bays = lots.layout.bay_mask.sum(axis=1)
    np.testing.assert_array_equal(bays, np.where(MEMBER, 10, 4))
    expected = np.minimum(np.clip(WANTED, 2, MOST), bays // 2)
    np.testing.assert_array_equal(lots.present, np.arange(MOST) < expected[:, None])
    np.testing.assert_array_equal(lots.active, lots.present)
    assert (expected < np.clip(WANTED, 2, MOST)).any()


def test_goals_come_first_and_parked_cars_take_what_is_left(lots):
    for lot in range(LOTS):
        mask, present = lots.layout.bay_mask[lot], lots.present[lot]
        goal, parked = lots.goal[lot], lots.parked_cars.bay[lot]
        assert (goal[~present] == NO_BAY).all()
        held = np.concatenate([goal[present], parked[parked != NO_BAY]])
        assert mask[held].all()
        assert len(set(held.tolist())) == len(held)
        # Of 4 bays 2 or 3 are to be taken, of 10 bays 5 to 8, as far as there are.
        bays, left = mask.sum(), mask.sum() - present.sum()
        count = (parked != NO_BAY).sum()
        assert min(0.5 * bays, left) <= count <= min(0.8 * bays, left)


def test_evaluation_counts_the_agents_that_lots_have(env):
    found = evaluate(env, random_policy(ActionSpec(2)), 24, seed=0, num_lots=12)
    present = {
        row["lot"]: (row["family"], row["agents_present"]) for row in found.episodes
    }
    # Two to seven agents in turn in six lots of each family.
    assert [count for _, count in present.values()] == [2] * 6 + [2, 3, 4, 5, 5, 5]
    assert {n: part["episodes"] for n, part in found.agent_counts.items()} == {
        n: n * lots for n, lots in zip(range(2, 6), (7, 1, 1, 3), strict=True)
    }


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"min_agents": 5}, r"min_agents must be at most 4 \(a goal bay each\), not 5"),
        ({"min_agents": None}, r"num_agents must be at most 4 .*, not 7"),
        # Without an occupancy every agent and every parked car needs its bay.
        ({"occupancy": None}, r"num_agents must be at most 4 .*, not 7"),
        (
            {"occupancy": None, "num_agents": 3},
            r"num_parked_cars must be at most 1 \(4 bays less 3 agents' goals\), not 8",
        ),
    ],
)
def test_more_agents_than_bays_need_an_occupancy_and_a_least_number(changes, message):
    config = dataclasses.replace(CONFIG, **changes)
    with pytest.raises(ValueError, match=message) as refusal:
        check_numbers(config, layout_config(config.layout))
    assert "\n" not in str(refusal.value)
    check_numbers(CONFIG, layout_config(CONFIG.layout))


def test_a_fleet_in_a_fixed_lot_may_have_more_agents_than_bays_too():
    config = dataclasses.replace(
        CONFIG,
        layout="square",
        num_agents=40,
        num_parked_cars=28,
        fleet=FleetConfig(("city", "van")),
        observation=ContinuousObservation(own_car=True),
    )
    assert ParkingEnv(config, SlidePhysics()).num_agents == 40

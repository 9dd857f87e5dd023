"""Evaluation: intervals, whole episodes, fixed quotas, the same result twice."""

import collections

import jax
import numpy as np
import pytest
from helpers.sliding import SlidePhysics

from carpark_mj.config import EnvConfig, EpisodeConfig, insert
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.aggregation import effective_episodes, wilson_interval
from carpark_mj.evaluation.evaluator import Evaluator, allot, evaluate
from carpark_mj.evaluation.keys import evaluation_key, training_key
from carpark_mj.layouts import StreetConfig, mixture
from carpark_mj.mdp.actions import ActionSpec
from carpark_mj.policy.acting import as_argument
from carpark_mj.policy.named import random_policy, zero_policy
from carpark_mj.types import ENDINGS


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(
        EnvConfig(
            num_agents=2,
            num_parked_cars=20,
            physics="bicycle",
            episode=EpisodeConfig(max_steps=30),
        )
    )


@pytest.fixture(scope="module")
def result(env):
    return evaluate(
        env, random_policy(ActionSpec(2)), num_episodes=20, seed=3, num_lots=4
    )


def test_every_agent_gives_the_same_number_of_whole_episodes(result):
    counts = collections.Counter((row["lot"], row["agent"]) for row in result.episodes)
    assert set(counts.values()) == {3}  # 20 episodes over 4 x 2 agents, rounded up
    assert len(counts) == 8


def test_one_program_evaluates_environments_that_differ_in_numbers(env, result):
    """As environments of their own; cars three times as large crash more often."""
    evaluator, policy = Evaluator(env), as_argument(random_policy(ActionSpec(2)))
    own = env.config.reward.time, env.config.episode.hitbox_scale
    paths = "reward.time", "episode.hitbox_scale"
    values = [dict(zip(paths, v, strict=True)) for v in ((-0.5, 3.0), own)]
    scaled, same = (evaluator.evaluate(policy, 20, 3, 4, values=v) for v in values)
    assert evaluator._chunk._cache_size() == evaluator._reset._cache_size() == 1
    other = evaluate(ParkingEnv(insert(env.config, values[0])), policy, 20, 3, 4)
    for found, expected in ((scaled, other), (same, result)):
        for row, want in zip(found.episodes, expected.episodes, strict=True):
            numbers = {n: v for n, v in want.items() if isinstance(v, float)}
            found_numbers = {name: row[name] for name in numbers}
            assert found_numbers == pytest.approx(
                numbers, rel=1e-5, abs=1e-5, nan_ok=True
            )
    sums = [
        {
            name: sum(row[name] for row in x.episodes)
            for name in ("crashed", "return_time")
        }
        for x in (scaled, same)
    ]
    assert sums[0]["crashed"] > sums[1]["crashed"]
    assert sums[0]["return_time"] > 0 > sums[1]["return_time"]


def test_a_span_counts_the_episodes_that_begin_within_it(env):
    policy, horizon = random_policy(ActionSpec(2)), 8.0  # s, 40 steps
    result = evaluate(env, policy, num_episodes=8, seed=3, num_lots=4, horizon=horizon)
    lengths: dict[tuple, list[float]] = {}
    for row in result.episodes:
        lengths.setdefault((row["lot"], row["agent"]), []).append(row["length"])
    assert len(lengths) == 8
    for steps in lengths.values():
        assert sum(steps[:-1]) < 40 <= sum(steps)
    with pytest.raises(ValueError, match="horizon must be positive, not 0"):
        evaluate(env, policy, num_episodes=8, seed=3, horizon=0.0)


def test_returns_by_term_add_up_in_every_episode_and_in_the_summary(result):
    by_term = result.summary["mean_returns"]
    assert {"park", "crash", "time", "progress"} <= by_term.keys()
    for row in result.episodes:
        total = sum(row[f"return_{name}"] for name in by_term)
        # float32 sums of 30 steps.
        assert total == pytest.approx(row["episode_return"], abs=1e-4)
    for name, mean in by_term.items():
        column = [row[f"return_{name}"] for row in result.episodes]
        assert mean == pytest.approx(np.mean(column))
    assert sum(by_term.values()) == pytest.approx(
        result.summary["episode_return"], abs=1e-4
    )
    crashes = sum(row["crashed"] for row in result.episodes)
    paid = sum(row["return_crash"] for row in result.episodes)
    assert paid == pytest.approx(-2.5 * crashes)


def test_every_episode_has_exactly_one_outcome_and_a_length(result):
    for row in result.episodes:
        assert sum(row[name] for name in ENDINGS) == 1
        assert 1 <= row["length"] <= 30
        assert (row["length"] == 30) or not row["timed_out"]


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(env, result):
    again = evaluate(
        env, random_policy(ActionSpec(2)), num_episodes=20, seed=3, num_lots=4
    )
    assert again.episodes == result.episodes
    other = evaluate(
        env, random_policy(ActionSpec(2)), num_episodes=20, seed=4, num_lots=4
    )
    assert other.episodes != result.episodes


def test_the_zero_policy_stands_until_time_is_up(env):
    found = evaluate(
        env, zero_policy(ActionSpec(2)), num_episodes=8, seed=0, num_lots=4
    )
    assert found.summary["timed_out"]["rate"] == 1.0
    assert max(row["path"] for row in found.episodes) < 0.01  # m in 6 s on the brake


@pytest.mark.parametrize(
    ("shares", "lots", "counts"),
    [
        ([0.25] * 4, 128, [32] * 4),
        ([0.25] * 4, 4, [1] * 4),
        ([0.25, 0.5, 0.25], 8, [2, 4, 2]),
        ([1.0], 3, [3]),
        ([1 / 3] * 3, 10, [3, 4, 3]),
    ],
)
def test_members_of_a_mixture_get_their_shares_of_the_lots(shares, lots, counts):
    assert np.bincount(allot(shares, lots), minlength=len(shares)).tolist() == counts


@pytest.mark.parametrize("episodes", [1, 40])
def test_rare_members_of_a_mixture_get_a_lot_with_every_number_of_agents(episodes):
    config = EnvConfig(
        layout=mixture(["square", "square_compact", "street"], [47, 2, 1]),
        num_agents=2,
        min_agents=1,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=1),
    )
    env = ParkingEnv(config, SlidePhysics())
    found = evaluate(env, random_policy(ActionSpec(2)), episodes, seed=0)
    driven = {(row["family"], row["agents_present"]) for row in found.episodes}
    assert len(driven) == 3 * 2


def test_families_are_summed_up_apart_and_add_up(mixed):
    of_lot = {row["lot"]: row["family"] for row in mixed.episodes}
    assert of_lot == dict(enumerate(["square_compact"] * 4 + ["street"] * 2))
    assert list(mixed.families) == ["square_compact", "street"]
    for name, summary in mixed.families.items():
        rows = [row for row in mixed.episodes if row["family"] == name]
        assert summary["episodes"] == len(rows)
        for outcome in ENDINGS:
            rate = summary[outcome]
            assert rate["count"] == sum(row[outcome] for row in rows)
            trials = effective_episodes(outcome, rows)
            expected = wilson_interval(rate["rate"] * trials, trials)
            assert (rate["low"], rate["high"]) == expected
    for outcome in ENDINGS:
        total = sum(summary[outcome]["count"] for summary in mixed.families.values())
        assert mixed.summary[outcome]["count"] == total


def test_an_evaluation_s_lots_are_held_out_and_follow_from_its_seed(
    mixed, mixture_env, monkeypatch
):
    env, asked = mixture_env, []

    def reset(key, split, *lot):
        asked.append(split)
        return ParkingEnv.reset(env, key, split, *lot)

    monkeypatch.setattr(env, "reset", reset)
    again = evaluate(env, random_policy(ActionSpec(2)), num_episodes=6, seed=3)
    assert again.episodes == mixed.episodes
    assert asked == ["test"]


@pytest.fixture(scope="module")
def crowds():
    """A mixture with one to three agents, and its evaluation."""
    street = StreetConfig(bays_per_side=(3, 4))
    config = EnvConfig(
        layout=mixture(["square_compact", street]),
        num_agents=3,
        min_agents=1,
        num_parked_cars=1,
        episode=EpisodeConfig(max_steps=5),
    )
    env = ParkingEnv(config, SlidePhysics())
    # 4 episodes of each of 2 agents a lot, on average, in 2 x 2 lots, rounded up to 6.
    return evaluate(
        env, random_policy(ActionSpec(2)), num_episodes=50, seed=0, num_lots=4
    )


def test_every_number_of_agents_gets_the_same_number_of_lots(crowds):
    of_lot = {row["lot"]: row["agents_present"] for row in crowds.episodes}
    family = {row["lot"]: row["family"] for row in crowds.episodes}
    assert of_lot == dict(enumerate([1, 2, 3] * 2))
    assert family == dict(enumerate(["square_compact"] * 3 + ["street"] * 3))
    counts = collections.Counter((row["lot"], row["agent"]) for row in crowds.episodes)
    present = {(lot, agent) for lot, n in of_lot.items() for agent in range(int(n))}
    assert counts == dict.fromkeys(present, 5)  # 50 episodes over 12 agents, rounded up


def test_numbers_of_agents_are_summed_up_apart_and_add_up(crowds, plain):
    parts = crowds.agent_counts
    assert [(n, part["episodes"]) for n, part in parts.items()] == [
        (1, 10),
        (2, 20),
        (3, 30),
    ]
    for outcome in ENDINGS:
        total = sum(part[outcome]["count"] for part in parts.values())
        assert crowds.summary[outcome]["count"] == total
    assert list(plain.agent_counts) == [3]
    assert {row["agents_present"] for row in plain.episodes} == {3}


def test_no_training_shares_its_key_with_an_evaluation():
    training, held_out = (
        {tuple(np.asarray(jax.random.key_data(key(seed)))) for seed in range(50)}
        for key in (training_key, evaluation_key)
    )
    assert len(training) == len(held_out) == 50
    assert not training & held_out

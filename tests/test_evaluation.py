"""Evaluation: intervals, whole episodes, fixed quotas, the same result twice."""

import collections

import jax
import numpy as np
import pytest

from carpark_mj.config import EnvConfig, EpisodeConfig, SimConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation import (
    HITS,
    OUTCOMES,
    evaluate,
    evaluation_key,
    random_policy,
    summarise,
    wilson_interval,
    zero_policy,
)


def test_wilson_intervals_match_published_values():
    # 8 of 10 (Agresti & Coull 1998 and any calculator): 0.490, 0.943.
    np.testing.assert_allclose(wilson_interval(8, 10), (0.4902, 0.9433), atol=1e-4)
    low, high = wilson_interval(0, 20)
    assert low == 0.0
    assert high == pytest.approx(0.1611, abs=1e-4)  # z^2 / (n + z^2)
    assert wilson_interval(20, 20)[1] == 1.0
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_a_summary_is_what_a_hand_count_gives():
    def row(outcome, hit="", length=10.0):
        flags = {name: float(name in (outcome, hit)) for name in OUTCOMES + HITS}
        numbers = dict.fromkeys(
            ("path", "gear_changes", "final_distance", "final_heading", "final_speed"),
            2.0,
        )
        return {**flags, **numbers, "length": length, "episode_return": 1.0}

    rows = [row("parked", length=20.0), row("parked"), row("crashed", "hit_wall")]
    rows.append(row("timed_out", length=200.0))
    summary = summarise(rows, ctrl_dt=0.2)
    assert summary["episodes"] == 4
    assert summary["parked"]["rate"] == 0.5
    assert summary["hit_wall"]["count"] == 1
    assert summary["parked_time"] == pytest.approx(3.0)  # mean of 20 and 10 steps
    assert summary["parked_heading_error_deg"] == pytest.approx(np.degrees(2.0))


@pytest.fixture(scope="module")
def env():
    return ParkingEnv(
        EnvConfig(
            num_agents=2,
            num_parked_cars=20,
            sim=SimConfig(sim_dt=0.02),
            episode=EpisodeConfig(max_steps=30),
        )
    )


@pytest.fixture(scope="module")
def result(env):
    return evaluate(env, random_policy(2), num_episodes=20, seed=3, num_lots=4)


def test_every_agent_gives_the_same_number_of_whole_episodes(result):
    counts = collections.Counter((row["lot"], row["agent"]) for row in result.episodes)
    assert set(counts.values()) == {3}  # 20 episodes over 4 x 2 agents, rounded up
    assert len(counts) == 8


def test_every_episode_has_exactly_one_outcome_and_a_length(result):
    for row in result.episodes:
        assert sum(row[name] for name in OUTCOMES) == 1
        assert 1 <= row["length"] <= 30
        assert (row["length"] == 30) or not row["timed_out"]


def test_the_same_seed_gives_the_same_bits_and_another_seed_does_not(env, result):
    again = evaluate(env, random_policy(2), num_episodes=20, seed=3, num_lots=4)
    assert again.episodes == result.episodes
    other = evaluate(env, random_policy(2), num_episodes=20, seed=4, num_lots=4)
    assert other.episodes != result.episodes


def test_the_zero_policy_stands_until_time_is_up(env):
    found = evaluate(env, zero_policy(2), num_episodes=8, seed=0, num_lots=4)
    assert found.summary["timed_out"]["rate"] == 1.0
    assert max(row["path"] for row in found.episodes) < 0.01  # m in 6 s on the brake


def test_evaluation_never_uses_training_s_key():
    for seed in range(3):
        training = jax.random.key_data(jax.random.fold_in(jax.random.key(seed), 0))
        held_out = jax.random.key_data(evaluation_key(seed))
        assert (training != held_out).any()


def test_impossible_evaluations_are_refused(env):
    with pytest.raises(ValueError, match="num_episodes must be at least 1, not 0"):
        evaluate(env, zero_policy(2), num_episodes=0, seed=0)

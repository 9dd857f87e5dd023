"""Tabular Q-learning: the update, the schedules, and a small run end to end."""

import dataclasses
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.programs import exit_code, rows_of

from carpark_mj.cli import evaluate
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.evaluator import evaluate as evaluate_policy
from carpark_mj.policy.loading import load_policy
from carpark_mj.policy.runs import checkpoint_files
from carpark_mj.training.run_folder import LOCK, open_run
from carpark_papers.tanner.environments import (
    TANNER_QLEARNING,
    TANNER_QLEARNING_RECORDED,
)
from carpark_papers.tanner.q_learning import program as q_learning
from carpark_papers.tanner.q_learning import train
from carpark_papers.tanner.q_learning.config import QLearningConfig
from carpark_papers.tanner.q_learning.tables import (
    action_choices,
    make_table_policy,
    state_index,
)
from carpark_papers.tanner.q_learning.train import (
    QLearner,
    Training,
    rolling_mean,
    write_metrics,
)

# Best actions of the study's four recorded Q-tables, by its smallest share of random
# actions (omarathon/rl-multi-agent-car-parking, q-learning-results): a digit for every
# bearing and, within it, speed; a digit is the acceleration plus 3 times the turn.
RECORDED = {
    "0.001": "511016013000433763076878",
    "0": "876223250006476763876877",
    "0.0001": "872210236006436613863576",
    "0.3": "854487072008200604513652",
}

SMALL = QLearningConfig(
    name="small", num_seeds=2, episodes=30, eval_episodes=10, window=10
)


@pytest.fixture(scope="module")
def learner():
    return QLearner(SMALL)


def test_rows_and_columns_of_the_table_are_the_combinations_in_order():
    sizes = (3, 8, 2)
    rows = list(itertools.product(*map(range, sizes)))
    index = state_index(jnp.array(rows, jnp.float32), sizes)
    np.testing.assert_array_equal(index, np.arange(math.prod(sizes)))
    outside = state_index(jnp.array([[-1.0, 9.0, 1.0]]), sizes)
    np.testing.assert_array_equal(outside, state_index(jnp.array([0, 7, 1]), sizes))
    pairs = action_choices(jnp.arange(9), (3, 3))
    np.testing.assert_array_equal(pairs, list(itertools.product(range(3), range(3))))


def test_a_table_policy_takes_the_first_of_the_best():
    table = jnp.zeros((4, 6)).at[1, 4].set(1.0).at[2, jnp.array([3, 5])].set(2.0)
    policy = make_table_policy(table, (2, 2), (2, 3))
    observation = jnp.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
    choices, _ = policy(observation, jax.random.key(0))
    np.testing.assert_array_equal(choices, [[0, 0], [1, 1], [1, 0]])


def drive_recorded(digits, env):
    """Summary of whole episodes that a recorded table drives in an environment."""
    best = np.array([*map(int, digits)]).reshape(8, 3)
    action = 3 * (best % 3) + best // 3
    table = jax.nn.one_hot(jnp.array(action.T.reshape(-1)), 9)
    policy = make_table_policy(table, (3, 8), (3, 3))
    return evaluate_policy(ParkingEnv(env), policy, 512, seed=0, num_lots=256).summary


@pytest.mark.parametrize("digits", RECORDED.values(), ids=RECORDED)
def test_the_study_s_tables_always_park_in_their_own_dynamics(digits):
    summary = drive_recorded(digits, TANNER_QLEARNING_RECORDED)
    assert summary["parked"]["rate"] == 1.0
    # Published: 10.20 to 10.22 over the last 500 episodes, of many starts.
    assert summary["episode_return"] == pytest.approx(10.21, abs=0.03)


def test_the_study_s_tables_mostly_fail_without_turns_at_rest():
    rate = drive_recorded(RECORDED["0.001"], TANNER_QLEARNING)["parked"]["rate"]
    assert 0.3 < rate < 0.5


def test_updates_are_those_of_a_plain_loop(learner):
    rng = np.random.default_rng(0)
    n, (states, actions) = 40, learner.table_shape
    state, following = rng.integers(0, 5, (2, n))
    action = rng.integers(0, actions, n)
    reward = rng.normal(size=n).astype(np.float32)
    terminated = rng.random(n) < 0.3
    table = rng.normal(size=(states, actions)).astype(np.float32)
    expected = table.copy()
    for s, a, r, f, t in zip(state, action, reward, following, terminated, strict=True):
        future = 0.0 if t else expected[f].max()
        expected[s, a] = 0.9 * expected[s, a] + 0.1 * (r + 0.9 * future)
    training = Training(jnp.array(table), None, None, jnp.array(3), None)
    transitions = tuple(
        jnp.array(x).reshape(4, 10)
        for x in (state, action, reward, following, terminated)
    )
    learned = learner._learn(training, transitions)
    np.testing.assert_allclose(learned, expected, rtol=1e-5, atol=1e-6)
    assert not np.allclose(learned, table)
    over = dataclasses.replace(training, episodes=jnp.array(SMALL.total_episodes))
    np.testing.assert_array_equal(learner._learn(over, transitions), table)


def test_rates_fall_over_training_and_nothing_is_random_afterwards(learner):
    episodes = jnp.array([0, 15, 29, 30, 39])
    alpha, epsilon = learner.rates(episodes)
    np.testing.assert_allclose(alpha, 0.1, rtol=1e-6)
    slope = (0.3 - 0.001) / 30
    expected = [0.3, 0.3 - 15 * slope, 0.3 - 29 * slope, 0.0, 0.0]
    np.testing.assert_allclose(epsilon, expected, rtol=1e-5)


def test_a_rolling_mean_by_hand():
    np.testing.assert_allclose(rolling_mean(np.arange(5.0), 2), [0.5, 1.5, 2.5, 3.5])
    np.testing.assert_allclose(rolling_mean(np.arange(3.0), 9), [1.0])
    assert len(rolling_mean(np.zeros(0), 3)) == 0


def test_no_row_of_metrics_mixes_training_and_evaluation(tmp_path):
    config = QLearningConfig(num_seeds=1, episodes=7, eval_episodes=5, window=4)
    # A return of 1 in evaluation, where all park; two episodes are not over yet.
    returns = (np.arange(12) >= 7)[None].astype(float)
    outcome = np.where(returns > 0, 0, 1).astype(np.int8)
    outcome[:, -2:] = -1
    made = {"episode_return": returns, "outcome": outcome, "length": np.ones((1, 12))}
    write_metrics(tmp_path, config, made)
    found = rows_of(tmp_path / "metrics.csv")
    rows = [(row["episode"], row["phase"], row["parked"]) for row in found]
    training = [(end, "training", "0.0") for end in ("4", "7")]
    assert rows == [*training, ("10", "evaluation", "1.0")]


@pytest.fixture(scope="module")
def run(learner, tmp_path_factory):
    """A small run from start to end, and the folder it wrote."""
    config = dataclasses.replace(SMALL, runs_dir=str(tmp_path_factory.mktemp("runs")))
    with open_run(config) as folder:
        assert train.train(config, learner, folder)
    return folder, train.load_or_init(learner, folder)


def test_every_seed_makes_its_episodes_and_they_add_up(run):
    _, made = run
    np.testing.assert_array_equal(made.counts, SMALL.total_episodes)
    length, outcome = made.episodes["length"], made.episodes["outcome"]
    assert length.min() >= 1
    assert length.max() == 85
    assert (length[outcome == 2] == 85).all()
    assert (outcome[length < 85] != 2).all()
    # Crashes and time-outs: -10 and at most 0.5 for what led there.
    returns = made.episodes["episode_return"]
    assert returns[outcome == 1].max() < -9.4
    assert np.abs(returns[outcome == 2]).max() <= 1.5 + 1e-4
    assert (returns[0] != returns[1]).any()
    assert made.training.table.shape == (2, 24, 9)
    # 24 x 9 = the 216 entries of the study.
    assert made.training.table.any(axis=(1, 2)).all()


def test_a_run_leaves_whole_files(run):
    folder, _ = run
    names = {path.name for path in folder.iterdir()}
    files = {"config.json", "checkpoints", "metrics.csv", "learning_curve.png"}
    assert names == {LOCK, *files}
    rows = (folder / "metrics.csv").read_text().splitlines()
    assert rows[0].startswith("seed,episode,phase,episode_return,length,parked,crashed")
    assert len(rows) == 1 + 2 * 4
    assert rows[3].startswith("0,30,training,")
    assert rows[4].startswith("0,40,evaluation,")


def test_a_run_cut_in_two_goes_on_exactly(learner, run, tmp_path):
    state = learner.init()
    straight = learner.advance(learner.advance(state)[0])[0]
    half = train.load_or_init(learner, tmp_path)
    half.training, ended = learner.advance(half.training)
    half.add(jax.device_get(ended))
    half.chunks = 1
    train.save(tmp_path, SMALL, half)
    loaded = train.load_or_init(learner, tmp_path)
    assert loaded.chunks == 1
    np.testing.assert_array_equal(loaded.counts, half.counts)
    resumed = learner.advance(loaded.training)[0]
    np.testing.assert_array_equal(resumed.table, straight.table)
    np.testing.assert_array_equal(
        resumed.lots.physics.point, straight.lots.physics.point
    )
    assert (resumed.lots.key == straight.lots.key).all()


def test_the_best_table_drives_in_evaluation(run, tmp_path):
    folder, made = run
    loaded = load_policy(folder)
    assert loaded.env == SMALL.env
    returns = made.episodes["episode_return"][:, -SMALL.window :].mean(axis=1)
    best = made.training.table[int(returns.argmax())]
    observation = jnp.array([[1.0, 3.0], [2.0, 0.0]])
    action, _ = loaded.policy(observation, jax.random.key(0))
    greedy = jnp.argmax(best[jnp.array([8 + 3, 16])], axis=-1)
    np.testing.assert_array_equal(action, action_choices(greedy, (3, 3)))
    config = evaluate.EvaluateConfig(run=str(folder), episodes=20, out=str(tmp_path))
    assert evaluate.main(config).summary["episodes"] == 20


def test_what_cannot_be_is_refused_in_a_sentence(run, capsys, tmp_path):
    folder, _ = run
    with pytest.raises(ValueError, match="needs grid physics, not mjx"):
        evaluate.main(evaluate.EvaluateConfig(run=str(folder), physics="mjx"))
    still = dataclasses.replace(SMALL.env.episode, respawn=False)
    frozen = dataclasses.replace(SMALL.env, episode=still)
    several = dataclasses.replace(SMALL.env, num_agents=2, min_agents=1)
    for env, needed in (
        (frozen, "needs env.episode.respawn = True"),
        (several, "env.min_agents = None, not 1"),
    ):
        with pytest.raises(ValueError, match=needed):
            QLearner(dataclasses.replace(SMALL, env=env))
    assert exit_code(q_learning, ["--resume", str(folder), "--gamma", "0.5"]) == 2
    assert (
        "a resumed run keeps its own settings: drop --gamma" in capsys.readouterr().err
    )
    assert exit_code(q_learning, ["--resume", str(tmp_path / "none")]) == 2
    assert "no run at" in capsys.readouterr().err
    (path,) = checkpoint_files(folder)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    try:
        assert exit_code(q_learning, ["--resume", str(folder)]) == 2
    finally:
        path.write_bytes(whole)
    assert "is truncated" in capsys.readouterr().err

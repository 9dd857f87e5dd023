"""Deep Q-learning at the junction: targets, and small runs end to end."""

import dataclasses

import numpy as np
import pytest
from helpers.programs import rows_of

pytest.importorskip("rlax", reason='pip install "./papers[junction]"')
pytest.importorskip("flashbax", reason='pip install "./papers[junction]"')

import jax
import jax.numpy as jnp

from carpark_mj.policy import runs
from carpark_mj.training.run_folder import open_run
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.dqn.learner import (
    DQNLearner,
    QNetwork,
    Transition,
    td_errors,
    to_agents,
    to_learners,
)
from carpark_papers.cederle.dqn.train import load_or_init, train

TINY = DQNConfig(
    name="tiny",
    hidden=(8,),
    num_junctions=4,
    total_steps=80,
    eval_period=40,
    eval_episodes=2,
    random_steps=8,
    batch_size=4,
    buffer_size=64,
    updates=1,
    video_episodes=0,
)

VALUES = jnp.array([[1.0, 2.0, 3.0, 4.0], [0.0, 5.0, 0.0, 0.0]])
TARGET_AFTER = jnp.array([[10.0, 20.0, 30.0, 0.0], [7.0, 7.0, 7.0, 7.0]])
ONLINE_AFTER = jnp.array([[9.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
BATCH = Transition(
    observation=jnp.zeros((2, 1)),
    action=jnp.array([2, 1]),
    reward=jnp.array([1.0, -10.0]),
    discount=jnp.array([0.5, 0.0]),  # the second episode ended
    next_observation=jnp.zeros((2, 1)),
    valid=jnp.ones(2, bool),
)


@pytest.fixture(scope="module")
def learner():
    return DQNLearner(TINY)


def test_targets_of_plain_and_double_q_learning_by_hand():
    # 1 + 0.5 * 30 - 3, and -10 - 5
    errors = td_errors(BATCH, VALUES, TARGET_AFTER, None)
    np.testing.assert_allclose(errors, [13.0, -15.0])
    # 1 + 0.5 * 10 - 3
    errors = td_errors(BATCH, VALUES, TARGET_AFTER, ONLINE_AFTER)
    np.testing.assert_allclose(errors, [3.0, -15.0])


def test_targets_are_constants_of_the_gradient():
    def loss(after):
        return td_errors(BATCH, VALUES, after, None).sum()

    np.testing.assert_array_equal(jax.grad(loss)(TARGET_AFTER), 0.0)


def test_training_never_starts_where_the_evaluation_does(learner):
    starts, _ = jax.jit(jax.vmap(learner.env.reset))(learner.config.evaluation_keys())
    held_out = jax.random.key_data(starts.key)
    training = jax.random.key_data(learner.init().state.key)
    assert not (held_out[:, None] == training).all(axis=-1).any()


@pytest.mark.parametrize("networks", [1, 3])
def test_what_is_sorted_by_network_comes_back_in_order(networks):
    x = jnp.arange(5 * 3 * 2).reshape(5, 3, 2)
    there = to_learners(x, networks)
    assert there.shape == (networks, 15 // networks, 2)
    np.testing.assert_array_equal(to_agents(there, 3), x)


def test_dueling_advantages_have_a_mean_of_zero():
    network = QNetwork(hidden=(4,), dueling=True)
    params = network.init(jax.random.key(0), jnp.ones(6))
    heads = params["params"]
    values = network.apply(params, jnp.ones(6))
    no_value = dict(heads) | {"Dense_2": jax.tree.map(jnp.zeros_like, heads["Dense_2"])}
    assert abs(values.mean()) > 1e-3
    rest = network.apply({"params": no_value}, jnp.ones(6))
    np.testing.assert_allclose(rest.mean(), 0.0, atol=1e-6)


def test_a_stopped_run_goes_on_to_what_an_unbroken_one_finds(learner, tmp_path):
    whole = dataclasses.replace(TINY, runs_dir=str(tmp_path))
    with open_run(whole) as folder:
        assert train(whole, learner, folder)
    parts = dataclasses.replace(whole, name="parts")
    with open_run(parts) as other:
        stopping = dataclasses.replace(parts, time_limit=1e-9)
        assert not train(stopping, learner, other)
        assert load_or_init(learner, other).chunks == 0
        assert not train(parts, StopAfterOne(learner), other)
        assert load_or_init(learner, other).chunks == 1
        assert train(parts, learner, other)
    for name in ("evaluations.csv", "metrics.csv"):
        assert (folder / name).read_text() == (other / name).read_text()
    rows = rows_of(folder / "evaluations.csv")
    assert [row["env_steps"] for row in rows] == ["0", "40", "80"]
    run = load_or_init(learner, folder)
    np.testing.assert_array_equal(run.training.learners.updates, [19, 19])
    assert (folder / "learning_curve.png").exists()
    assert runs.checkpoint_files(folder)


class StopAfterOne:
    """A learner during whose first chunk the user presses Ctrl-C."""

    def __init__(self, learner):
        self.config, self.init = learner.config, learner.init
        self.evaluate, self._advance = learner.evaluate, learner.advance

    def advance(self, training):
        import signal

        signal.raise_signal(signal.SIGINT)
        return self._advance(training)


def test_images_are_learnt_from(tmp_path):
    config = dataclasses.replace(
        TINY,
        runs_dir=str(tmp_path),
        observation="image",
        pixels=36,
        num_junctions=2,
        total_steps=20,
        eval_period=20,
        max_steps=5,
    )
    learner = DQNLearner(config)
    before = learner.init().learners.params
    with open_run(config) as folder:
        assert train(config, learner, folder)
    run = load_or_init(learner, folder)
    np.testing.assert_array_equal(run.training.learners.updates, [7, 7])
    moved = jax.tree.map(
        lambda x, y: bool((x != y).any()), before, run.training.learners.params
    )
    assert all(jax.tree.leaves(moved))


def test_deep_q_learning_learns_to_arrive(tmp_path):
    config = DQNConfig(
        name="learns",
        runs_dir=str(tmp_path),
        num_junctions=16,
        total_steps=6_400,
        eval_period=3_200,
        eval_episodes=8,
        random_steps=500,
        updates=2,
        batch_size=64,
        buffer_size=20_000,
        epsilon_steps=5_000,
        target_period=100,
        hidden=(64, 64),
        video_episodes=0,
    )
    with open_run(config) as folder:
        assert train(config, DQNLearner(config), folder)
    rows = rows_of(folder / "evaluations.csv")
    assert float(rows[-1]["return"]) > 60.0

"""SAC in phases: small runs end to end, resumed ones, and what its buffer gives."""

import dataclasses
import json

import numpy as np
import pytest
from helpers.programs import exit_code, rows_of

pytest.importorskip("sbx", reason='pip install -e ".[sb3]"')

import jax
import jax.numpy as jnp

from carpark_mj.policy import checkpoints, runs
from carpark_mj.training.run_folder import open_run
from carpark_papers.pandita.sac import agent as agents
from carpark_papers.pandita.sac import program as sac
from carpark_papers.pandita.sac.config import SACConfig
from carpark_papers.pandita.sac.deploy import choose_action
from carpark_papers.pandita.sac.train import Training, train

TINY = SACConfig(
    name="tiny",
    phases=("slots:700", "slots_diagonal:2episodes"),
    deploy=("slots", "slots_diagonal"),
    num_cars=4,
    gradient_steps=2,
    batch_size=32,
    buffer_size=2000,
    random_steps=160,
    hidden=(16,),
    eval_episodes=2,
    video_seconds=0.0,
)


def flags(config, tmp_path):
    """The command line of a config; the settings of `TINY` are not the defaults."""
    words = ["--runs-dir", str(tmp_path)]
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if field.name not in ("runs_dir", "resume", "preset"):
            words += [f"--{field.name.replace('_', '-')}"]
            words += [str(v) for v in (value if isinstance(value, tuple) else [value])]
    return words


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    assert exit_code(sac, flags(TINY, root)) == 0
    return root / "tiny"


def test_a_run_leaves_what_it_found(folder):
    written = {path.name for path in folder.iterdir()}
    assert {
        "config.json",
        "deployments.csv",
        "evaluation.json",
        "learning_curve.png",
        "metrics.csv",
        "success_matrix.png",
        "tensorboard",
    } <= written
    found = rows_of(folder / "deployments.csv")
    assert [row["phase"] for row in found] == [str(k) for k in range(3) for _ in "abcd"]
    assert {row["kind"] for row in found} == {"slots", "slots_diagonal"}
    assert {row["policy"] for row in found} == {"deterministic", "sampled"}
    transfer = json.loads((folder / "evaluation.json").read_text())["transfer"]
    assert set(transfer["deterministic"]) == {"average", "backward", "forward"}
    metrics = rows_of(folder / "metrics.csv")
    assert (metrics[0]["phase"], metrics[-1]["phase"]) == ("0", "1")
    assert float(metrics[0]["env_steps"]) == 700


def test_a_stopped_run_goes_on_where_it_stopped(tmp_path):
    config = dataclasses.replace(TINY, runs_dir=str(tmp_path))
    with open_run(config) as folder:
        assert train(dataclasses.replace(config, time_limit=1e-9), folder) is None
        before = Training(config, folder)
        assert before.progress.total == TINY.num_cars  # a step, then it stopped
        resumed = train(config, folder)
    assert resumed is not None
    assert resumed.progress.phase == 2
    assert len(resumed.deployments) == 3 * 2 * 2
    totals = [float(row["env_steps"]) for row in rows_of(folder / "metrics.csv")]
    assert totals == sorted({*totals})


def test_a_checkpoint_holds_networks_and_buffer(folder):
    path = runs.latest_checkpoint(folder)
    header = checkpoints.read_header(path)
    training = Training(TINY, folder)
    buffer = training.agent.replay_buffer
    total = header["progress"]["total"]
    assert training.agent.num_timesteps == total
    # Every phase loses the step that ended it.
    assert buffer.pos == total // TINY.num_cars - len(TINY.phases)
    kept = checkpoints.load(path, agents.arrays(training.agent))
    for ours, theirs in zip(
        jax.tree.leaves(kept["actor"].params),
        jax.tree.leaves(training.agent.policy.actor_state.params),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)
    buffer.sample(50)
    np.testing.assert_array_equal(buffer.actions, kept["buffer"]["actions"])


def test_deployment_drives_as_the_agent_does(folder):
    agent = Training(TINY, folder).agent
    seen = agent.env.reset()
    action, _ = agent.predict(seen, deterministic=True)
    parts = [seen[name] for name in ("observation", "achieved_goal", "desired_goal")]
    vector = jnp.concatenate(parts, axis=-1)
    policy = agent.policy
    params, key = policy.actor_state.params, jax.random.key(0)
    ours = choose_action(policy.actor.apply, False, params, vector, key)
    np.testing.assert_allclose(ours, action, atol=1e-5)


def test_every_batch_has_its_share_of_relabelled_transitions(folder):
    buffer = Training(TINY, folder).agent.replay_buffer
    goals = buffer.observations["desired_goal"][: buffer.pos].reshape(-1, 6)
    real = {tuple(goal) for goal in goals.tolist()}
    drawn = buffer.sample(1000).observations["desired_goal"].numpy()
    relabelled = [tuple(goal) not in real for goal in drawn.tolist()]
    for batch in np.split(np.array(relabelled), 10):
        assert 0.5 < batch.mean() < 1.0  # 0.8 of all


def test_a_balanced_buffer_gives_phases_equal_shares(folder):
    config = dataclasses.replace(TINY, at_switch="balance")
    buffer = Training(config, folder).agent.replay_buffer
    assert buffer.phase == 1
    rows = buffer.phase_of_row[: buffer.pos]
    assert (rows == 1).sum() > 0
    sample = buffer.sample(400)
    first = buffer.actions[: buffer.pos][rows == 0].reshape(-1, 2)
    known = {tuple(action) for action in first.tolist()}
    old = [tuple(action) in known for action in sample.actions.numpy().tolist()]
    assert sum(old) == 200
    lengths = buffer.ep_length.copy()
    buffer.sample(10)
    np.testing.assert_array_equal(buffer.ep_length, lengths)


def test_a_cleared_buffer_has_nothing_to_sample(folder):
    agent = Training(TINY, folder).agent
    assert agents.is_ready(agent.replay_buffer)
    agents.clear(agent.replay_buffer)
    assert not agents.is_ready(agent.replay_buffer)
    updates = agent._n_updates
    agent.train(2, 32)
    assert agent._n_updates == updates


@pytest.mark.parametrize("kind", ["plain", "none"])
def test_other_buffers_learn_as_well(kind, tmp_path):
    config = dataclasses.replace(
        TINY, phases=("slots:720",), deploy=("slots",), replay=kind, at_switch="clear"
    )
    with open_run(dataclasses.replace(config, runs_dir=str(tmp_path))) as folder:
        training = train(config, folder)
    assert training is not None
    assert training.agent._n_updates > 0
    size = training.agent.replay_buffer.buffer_size
    assert size == (1 if kind == "none" else 500)

"""Training from Python: the run, its callback, what is made of it."""

import dataclasses

import jax
import pytest
from helpers.sliding import POSES

import carpark_mj
from carpark_mj.cli import evaluate as evaluate_command
from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training import PPOConfig, Run, evaluate, train

jax.devices()  # JAX runs, as in the other tests of this process
UPDATES = 3
TINY = PPOConfig(
    num_steps=UPDATES * 32,
    num_lots=4,
    unroll_length=4,
    num_minibatches=2,
    networks=NetworkConfig((8,), (8,)),
    env=EnvConfig(
        physics="bicycle", observation=POSES, num_agents=2, num_parked_cars=2
    ),
)


def run_of(folder, callback):
    config = {**vars(TINY), "runs_dir": str(folder)}
    return train(PPOConfig(**config), callback=callback)


@pytest.fixture(scope="module")
def told():
    return []


@pytest.fixture(scope="module")
def run(tmp_path_factory, told):
    return run_of(tmp_path_factory.mktemp("runs"), lambda row: told.append(dict(row)))


def test_the_callback_gets_every_update_s_row_of_the_metrics(run, told):
    assert run.outcome == "done"
    assert [row["update"] for row in told] == [*range(1, UPDATES + 1)]
    for row, written in zip(told, run.metrics, strict=True):
        assert row == pytest.approx(written, nan_ok=True)


def test_the_run_has_the_policy_and_can_be_evaluated(run, monkeypatch):
    assert run.policy.env == TINY.env
    assert run.policy.steps == TINY.num_steps
    asked = []
    monkeypatch.setattr(evaluate_command, "main", asked.append)
    for given in (run, run.folder, str(run.folder)):
        evaluate(given, episodes=8)
    assert {(x.run, x.episodes) for x in asked} == {(str(run.folder), 8)}
    evaluate(run.policy)
    assert asked[-1].run == str(run.policy.path)
    other = dataclasses.replace(run.policy, env=EnvConfig())
    with pytest.raises(ValueError, match="another environment"):
        carpark_mj.evaluate(other)
    assert {"evaluate", "render", "ParkingEnv"} <= {*dir(carpark_mj)}


@pytest.mark.slow
def test_a_callback_ends_a_training_that_can_go_on(tmp_path):
    stopped = run_of(tmp_path, lambda row: row["update"] == 2)
    assert stopped.outcome == "stopped"
    assert [row["update"] for row in stopped.metrics] == [1, 2]
    again = PPOConfig(**{**vars(TINY), "resume": str(stopped.folder)})
    assert train(again) == Run(stopped.folder)
    assert [row["update"] for row in stopped.metrics] == [1, 2, 3]

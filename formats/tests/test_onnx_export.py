"""`carpark_mj export`: a checked ONNX model or a policy alone, or nothing."""

import dataclasses

import jax
import numpy as np
import onnxruntime
import pytest
from helpers import tiny_policy
from helpers.disks import no_printing
from helpers.programs import assert_refused, exit_code
from helpers.tiny_policy import parked_learner
from rich.console import Console

from carpark_formats.onnx import export as command
from carpark_formats.onnx.models import split_observation
from carpark_formats.settings import OnnxConfig
from carpark_mj import pretrained
from carpark_mj.config import insert
from carpark_mj.observations import observation_size
from carpark_mj.policy import loading
from carpark_mj.training.ppo.train import save

TINY = insert(tiny_policy.TINY, {"env.num_agents": 3, "env.min_agents": 1})


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export") / "tiny"
    folder.mkdir()
    save(folder, TINY, parked_learner(TINY).init())
    return folder


@pytest.fixture(scope="module")
def once():
    """Calls functions once for every environment and settings."""
    known = {}

    def remembered(function):
        def call(loaded, *given):
            settings = [
                len(x["observation"]) if isinstance(x, dict) else x for x in given
            ]
            key = function.__name__, loaded.env, *settings
            if key not in known:
                known[key] = function(loaded, *given)
            return known[key]

        return call

    return remembered


@pytest.fixture
def quick(monkeypatch, once):
    """Fewer observations are compared, and each roll-out is driven once."""
    export = command.models
    monkeypatch.setattr(command, "CHECKED", 200)
    monkeypatch.setattr(command, "rollout", once(command.rollout))
    monkeypatch.setattr(export, "sensitivity", once(export.sensitivity))


def refused(capsys, *words, said):
    """Asserts that a call is refused for a reason."""
    assert_refused(capsys, "export", [str(word) for word in words], said)


def test_a_run_becomes_a_model_that_is_checked(trained, capsys, monkeypatch, quick):
    monkeypatch.setenv("COLUMNS", "200")
    assert exit_code("export", [str(trained)]) == 0
    out = capsys.readouterr().out
    assert "200 observations of a roll-out: " in out
    assert "own road-wheel angle [its limit], left > 0" in out
    path = trained / "policy.onnx"
    assert f"wrote {path}" in out
    loaded = loading.load_policy(trained)
    seen = command.rollout(loaded, command.CHECKED, 0)["observation"]
    session = onnxruntime.InferenceSession(path)
    [action] = session.run(None, split_observation(loaded.env, seen))
    expected, _ = loaded.policy(seen, jax.random.key(0))
    np.testing.assert_allclose(action, expected, atol=1e-5)


def test_a_model_is_written_before_it_is_described(
    trained, tmp_path, monkeypatch, quick
):
    monkeypatch.setattr(Console, "print", no_printing)
    with pytest.raises(BrokenPipeError):
        command.main(OnnxConfig(str(trained), str(tmp_path / "a.onnx")))
    assert [path.name for path in tmp_path.iterdir()] == ["a.onnx"]


def test_a_pretrained_policy_is_exported_into_runs(
    trained, tmp_path, monkeypatch, quick
):
    monkeypatch.setattr(pretrained, "FOLDER", tmp_path)
    assert exit_code("export", [str(trained), "--out", str(tmp_path / "tiny.npz")]) == 0
    monkeypatch.chdir(tmp_path)
    assert exit_code("export", ["tiny"]) == 0
    assert [path.name for path in tmp_path.glob("runs/tiny/*")] == ["policy.onnx"]


def test_a_model_that_acts_otherwise_is_not_written(
    trained, tmp_path, capsys, monkeypatch, quick
):
    make = command.models.make_model

    def wrong(loaded):
        def act(observation, key):
            action, extras = loaded.policy(observation, key)
            return action + 2e-5, extras

        return make(dataclasses.replace(loaded, policy=act))

    monkeypatch.setattr(command.models, "make_model", wrong)
    said = "differs from the policy by 2e-05"
    refused(capsys, trained, "--out", tmp_path / "a.onnx", said=said)
    assert list(tmp_path.iterdir()) == []


def test_a_model_with_the_observation_inside_is_checked_too(
    trained, tmp_path, capsys, monkeypatch, quick
):
    out = tmp_path / "car.onnx"
    flags = [str(trained), "--from-state", "--out", str(out)]
    assert exit_code("export", flags) == 0
    assert "200 observations of a roll-out: " in capsys.readouterr().out
    assert out.exists()
    make, made = command.models.make_car_model, []

    def wrong(loaded, rows):
        policy = loaded.policy
        other = lambda seen, key: (policy(seen, key)[0] + 2e-3, {})  # noqa: E731
        if not made:
            made.append(make(dataclasses.replace(loaded, policy=other), rows))
        return made[0]

    monkeypatch.setattr(command.models, "make_car_model", wrong)
    out.unlink()
    refused(capsys, *flags, said="differs from the policy by 0.002")
    assert not out.exists()
    # It may where float32 costs as much, and in no other state.
    for costly, code in ((200, 0), (199, 2)):
        cost = np.where(np.arange(200) < costly, 1.0, 0.0)
        monkeypatch.setattr(command.models, "sensitivity", lambda *_, cost=cost: cost)
        assert exit_code("export", flags) == code


def test_observations_of_a_rollout_are_of_agents_that_drive(trained, quick):
    loaded, count = loading.load_policy(trained), command.CHECKED
    seen = command.rollout(loaded, count, 0)["observation"]
    assert seen.shape == (count, observation_size(TINY.env))
    assert np.isfinite(seen).all()
    assert seen.any(axis=-1).all()  # agents that are absent do not count
    assert len(np.unique(seen, axis=0)) == count
    assert np.ptp(seen[:, 0]) > 0.01  # speeds: they start at rest


BAD = {
    "no run": ("nowhere", "no run folder or checkpoint at nowhere"),
    "another format": ("zero --out a.pb", "out must end in .onnx or .npz"),
    "no rows": ("zero --others 3", "others 3 has no effect without --from-state"),
    "unwritable": ("{run} --out /proc/a.npz", "/proc/a.npz"),
}


@pytest.mark.parametrize("case", sorted(BAD))
def test_bad_input_is_one_sentence_and_exit_code_2(case, trained, capsys):
    words, said = BAD[case]
    refused(capsys, *words.format(run=trained).split(), said=said)

"""Training from Python: its loop, log and learning curve, what is made of it."""

import contextlib
import csv
import dataclasses
import json

import jax
import numpy as np
import pytest
from helpers.learning import SMALL
from helpers.registering import restore_after

import carpark_mj
from carpark_mj.cli import evaluate as evaluate_command
from carpark_mj.cli.settings.training import RunConfig
from carpark_mj.config import (
    EnvConfig,
    EpisodeConfig,
    RayConfig,
    RingConfig,
    SpawnConfig,
    insert,
)
from carpark_mj.observations import ContinuousObservation
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.rendering.video import write_video
from carpark_mj.training import PPOConfig, evaluate, train
from carpark_mj.training.loggers import CALLBACKS, LOGGERS, Callback
from carpark_mj.training.loop import (
    MetricsLog,
    plot_learning_curve,
    read_metrics,
    smooth,
)
from carpark_mj.training.ppo.learner import Learner
from carpark_mj.training.run_folder import open_run


def test_tensorboard_has_what_is_logged_the_settings_and_the_video(tmp_path):
    accumulator = pytest.importorskip(
        "tensorboard.backend.event_processing.event_accumulator"
    )
    write_video(tmp_path / "a.mp4", iter(np.zeros((4, 36, 64, 3), np.uint8)), 2.0)
    for begun in (0, 2):  # a run, then resumed after its second update
        with contextlib.closing(MetricsLog(tmp_path, begun, PPOConfig(seed=7))) as log:
            for update in range(begun + 1, begun + 4):
                log.write(row(update))
    with contextlib.closing(MetricsLog(tmp_path, 5, PPOConfig(seed=7))) as log:
        log.video(tmp_path / "a.mp4")
    events = accumulator.EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    found = [(event.step, event.value) for event in events.Scalars("loss")]
    assert found == [(10 * update, update / 2) for update in range(1, 6)]
    rows = [(row["env_steps"], row["loss"]) for row in read_metrics(tmp_path)]
    assert rows == found
    [image] = events.Images("video")
    assert image.encoded_image_string[:3] == b"GIF"
    assert image.width * 36 == image.height * 64
    settings = events.PluginTagToContent("hparams")["_hparams_/session_start_info"]
    assert b"env.num_agents" in settings


def test_an_extension_s_logger_gets_all_that_is_finite(tmp_path, monkeypatch):
    restore_after(monkeypatch, LOGGERS)
    told = []

    class Mine:
        def __init__(self, folder, step, settings):
            told.append((folder, step, settings["seed"]))

        def write(self, step, values):
            told.append((step, values))

        def video(self, step, path):
            told.append((step, path))

        def close(self):
            told.append("closed")

    LOGGERS.register("mine", Mine)
    config = PPOConfig(seed=7, logger="mine")
    with contextlib.closing(MetricsLog(tmp_path, 0, config)) as log:
        log.write(row(1) | {"empty": float("nan")})
        log.video(tmp_path)
    first, *others = told
    assert first == (tmp_path, 0, 7)
    assert others == [(10, {"loss": 0.5}), (10, tmp_path), "closed"]
    assert not (tmp_path / "tensorboard").exists()


@pytest.mark.parametrize("name", ["mlfow", "wandb,none"])
def test_an_unknown_logger_is_refused_before_there_is_a_folder(name, tmp_path):
    config = PPOConfig(logger=name, runs_dir=str(tmp_path / "runs"))
    with pytest.raises((ValueError, ModuleNotFoundError)), open_run(config):
        pass
    assert not (tmp_path / "runs").exists()


def row(update):
    return {"update": update, "env_steps": 10 * update, "loss": 0.5 * update}


@pytest.fixture
def log(tmp_path):
    """A file of three updates."""
    with contextlib.closing(MetricsLog(tmp_path, 0, RunConfig())) as opened:
        for update in (1, 2, 3):
            opened.write(row(update))
    return tmp_path / "metrics.csv"


def go_on(log, update):
    with contextlib.closing(MetricsLog(log.parent, update, RunConfig())) as opened:
        opened.write(row(update + 1))
    return [row["update"] for row in read_metrics(log.parent)]


def test_rows_after_the_checkpoint_are_written_anew(log):
    assert go_on(log, 2) == [1, 2, 3]
    with log.open("a") as file:
        file.write("4,4")
    assert [row["loss"] for row in read_metrics(log.parent)] == [0.5, 1.0, 1.5]
    assert go_on(log, 3) == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("update", "updates", "lacks the columns update"),
        ("0.5", "x", "line 2: loss .*'x'"),
        ("0.5", "0.5,1", "line 2: not as many values"),
    ],
)
def test_a_damaged_log_is_refused_and_stays_as_it_is(log, old, new, said):
    log.write_text(log.read_text().replace(old, new, 1))
    text = log.read_bytes()
    with pytest.raises(ValueError, match=rf"metrics\.csv.* {said}"):
        MetricsLog(log.parent, 3, RunConfig())
    assert log.read_bytes() == text


def test_smoothing_weights_by_episodes_and_keeps_constants():
    np.testing.assert_allclose(smooth(np.full(50, 0.3), np.arange(1.0, 51.0)), 0.3)
    # Two updates: one episode with rate 1, three with rate 0.
    np.testing.assert_allclose(smooth(np.array([1.0, 0.0]), np.array([1.0, 3.0]))[0], 1)
    np.testing.assert_allclose(
        smooth(np.array([1.0, 0.0, 0.0]), np.array([1.0, 3.0, 0.0]), window=3)[1], 0.25
    )


@pytest.mark.parametrize("episodes", [(), (0, 0), (0, 3, 2)])
def test_a_run_in_which_no_episode_ended_still_has_a_picture(tmp_path, episodes):
    names = ("parked", "crashed", "timed_out", "episode_return")
    columns = ["update", "env_steps", "episodes", *(f"episode/{n}" for n in names)]
    with (tmp_path / "metrics.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for k, count in enumerate(episodes):
            rate = "0.5" if count else "nan"
            writer.writerow([k + 1, 100 * (k + 1), count, rate, rate, rate, rate])
    assert plot_learning_curve(tmp_path).read_bytes()[:4] == b"\x89PNG"


jax.devices()  # JAX runs, as in the other tests of this process
UPDATES = 3
TINY = insert(SMALL, {"num_steps": UPDATES * 32, "num_lots": 4, "num_minibatches": 2})


def test_a_run_tells_its_rows_has_the_policy_and_can_be_evaluated(
    tmp_path, monkeypatch
):
    told = []

    def tell(row):
        told.append(dict(row))
        return row["update"] == 2  # the training ends

    config = insert(TINY, {"runs_dir": str(tmp_path)})
    run = train(config, callback=tell)
    assert run.outcome == "stopped"
    assert [row["update"] for row in told] == [1, 2]
    for row, written in zip(told, run.metrics, strict=True):
        assert row == pytest.approx(written, nan_ok=True)
    assert run.policy.env == TINY.env
    assert run.policy.steps == 2 * TINY.steps_per_update
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


class Ramp(Callback):
    """Time costs more with the progress; the second update is the last."""

    def values(self, progress):
        return {"env.reward.time": 1.0 + progress, "learning_rate": 1e-3}

    def after(self, metrics):
        assert (self.folder / "metrics.csv").exists()
        return metrics["update"] == 2


def test_registered_callbacks_change_settings_and_end_the_training(
    tmp_path, monkeypatch
):
    restore_after(monkeypatch, CALLBACKS)
    CALLBACKS.register("ramp", Ramp)
    CALLBACKS.register("off", Off)
    programs, compile_ = [], Learner.compile

    def keep(self, scheduled):
        programs.append(compile_(self, scheduled))
        return programs[-1]

    monkeypatch.setattr(Learner, "compile", keep)
    config = insert(TINY, {"callbacks": "ramp", "runs_dir": str(tmp_path)})
    run = train(config)
    assert run.outcome == "stopped"
    for row, paid in zip(run.metrics, (1.0, 1.0 + 1 / UPDATES), strict=True):
        each = -paid / config.env.episode.max_steps
        assert row["reward/time"] == pytest.approx(each, rel=1e-4)
    assert programs[0]._cache_size() == 1
    for name, message in (
        ("rmap", "did you mean 'ramp'"),
        ("off", "speed_noise = 0.0"),
    ):
        with pytest.raises(ValueError, match=message):
            train(insert(config, {"callbacks": name}))
    assert len([*tmp_path.iterdir()]) == 1


class Off(Callback):
    """Asks for noise that the environment does not have."""

    def values(self, progress):
        return {"env.sensors.speed_noise": progress}


LOT = {
    "format": "carpark_mj layout 1",
    "bays": [{"pose": [0.0, 0.0, 0.0], "size": [7.0, 4.0]}],
    "spawns": [{"pose": [-6.0, 0.0, 0.0], "size": [0.5, 0.2], "spread": 0.0}],
    "extent": [15.0, 6.0],
}


@pytest.mark.slow
def test_at_first_it_hardly_ever_parks_straight_on_and_soon_always(tmp_path):
    path = tmp_path / "straight_on.json"
    path.write_text(json.dumps(LOT))
    env = EnvConfig(
        layout=str(path),
        num_agents=1,
        num_parked_cars=0,
        physics="bicycle",
        spawn=SpawnConfig(close_ratio=0.0),
        episode=EpisodeConfig(max_steps=50),
        observation=ContinuousObservation(0, 0, rings=RingConfig(), rays=RayConfig(0)),
    )
    config = PPOConfig(
        num_lots=64,
        unroll_length=50,
        num_minibatches=2,
        learning_rate=3e-3,
        networks=NetworkConfig((32,), (32,), encoder="flat"),
        env=env,
    )
    learner = Learner(config)
    update, state, rates = learner.compile(), learner.init(), []
    for _ in range(40):
        state, metrics = update(state)
        rates.append(float(metrics["episode/parked"]))
    assert np.mean(rates[:3]) < 0.2
    assert np.mean(rates[-5:]) > 0.95

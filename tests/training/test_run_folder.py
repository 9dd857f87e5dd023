"""Run folders and settings of runs: names, locks, presets and flags."""

import dataclasses
import json
import shutil

import pytest
from jax.errors import JaxRuntimeError

from carpark_mj.files import write_json
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.runs import CONFIG_VERSION, latest_checkpoint, save_checkpoint
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS, summaries
from carpark_mj.training.run_folder import (
    LOCK,
    describe,
    open_run,
    read_config,
    read_header,
    read_settings,
)

LEFT = ".step_000000000064.0123456789abcdef.npz"  # by a process that was killed


def test_a_run_that_goes_on_begins_without_unfinished_files(tmp_path):
    with open_run(PPOConfig(name="a", runs_dir=str(tmp_path))) as folder:
        save_checkpoint(folder, {}, {}, 1)
    left = [folder / LEFT, folder / "checkpoints" / LEFT]
    kept = [folder / ".notes.npz", *folder.rglob("step_*.npz"), folder / LOCK]
    for path in (*left, kept[0]):
        path.touch()
    with open_run(PPOConfig(resume=str(folder))):
        assert not any(path.exists() for path in left)
        assert all(path.exists() for path in kept)


@pytest.mark.parametrize("name", ["/tmp/x", "a/b", "a\\b", "..", " "])
def test_a_name_is_that_of_one_folder(name):
    with pytest.raises(ValueError, match="name must be the name of one folder"):
        PPOConfig(name=name)
    assert PPOConfig(name="a b.c-2").name == "a b.c-2"


def test_a_folder_is_held_by_one_process_at_a_time(tmp_path):
    config = PPOConfig(name="mine", runs_dir=str(tmp_path))
    with open_run(config) as folder:
        resumed = dataclasses.replace(config, resume=str(folder))
        said = f"another process trains in {folder}"
        with pytest.raises(ValueError, match=said), open_run(resumed):
            pass
    with open_run(resumed) as again:  # given back
        assert again == folder


def test_a_taken_name_is_refused_and_unnamed_runs_count_up(tmp_path):
    def opened(name=""):
        config = PPOConfig(preset="cpu", name=name, runs_dir=str(tmp_path))
        with open_run(config) as folder:
            return folder.name

    assert opened("mine") == "mine"
    with pytest.raises(ValueError, match=r"mine exists.*--resume"):
        opened("mine")
    assert [opened() for _ in range(3)] == ["cpu-0", "cpu-0-2", "cpu-0-3"]
    git = tmp_path / "project" / ".git"  # a folder of somebody else
    git.mkdir(parents=True)
    with pytest.raises(ValueError, match="exists: choose another --name"):
        opened("project")
    assert git.is_dir()


def fail(config, error, write):
    """A run that writes something and then fails."""
    with open_run(config) as folder:
        write(folder)
        raise error


@pytest.mark.parametrize(
    "error",
    [
        ValueError("sizes"),
        MemoryError(),
        OSError(28, "No space left on device"),
        JaxRuntimeError("RESOURCE_EXHAUSTED: Out of memory"),
        CheckpointError("other networks"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_a_run_without_a_checkpoint_leaves_no_folder(tmp_path, error):
    config = PPOConfig(name="mine", runs_dir=str(tmp_path))
    for _ in range(2):  # the name is free again
        with pytest.raises(type(error)):
            fail(config, error, lambda folder: (folder / "tensorboard").mkdir())
        assert not list(tmp_path.iterdir())


def test_what_was_trained_or_interrupted_or_resumed_is_kept(tmp_path):
    config = PPOConfig(name="mine", runs_dir=str(tmp_path))
    with pytest.raises(KeyboardInterrupt), open_run(config) as folder:
        raise KeyboardInterrupt
    with (
        pytest.raises(MemoryError),
        open_run(dataclasses.replace(config, resume=str(folder))),
    ):
        raise MemoryError
    assert read_config(PPOConfig, folder) == config
    other = dataclasses.replace(config, name="other")
    with pytest.raises(MemoryError):
        fail(other, MemoryError(), lambda folder: save_checkpoint(folder, {}, {}, 1))
    assert read_config(PPOConfig, tmp_path / "other") == other
    assert latest_checkpoint(tmp_path / "other").is_file()


def test_settings_come_back_and_older_versions_are_refused(tmp_path):
    config = PPOConfig(name="mine", runs_dir=str(tmp_path), clip=0.3)
    with open_run(config) as folder:
        assert read_config(PPOConfig, folder) == config
    path = folder / "config.json"
    described = json.loads(path.read_text())
    del described["config_version"]
    path.write_text(json.dumps(described))
    with pytest.raises(CheckpointError, match="is of another carpark_mj"):
        read_config(PPOConfig, folder)
    junk = described | {"config_version": CONFIG_VERSION, "config": {"name": 1}}
    for damaged in ("{", "[]", "{}", json.dumps(junk)):
        path.write_text(damaged)
        with pytest.raises(CheckpointError, match="is not the config of a run"):
            read_config(PPOConfig, folder)


def test_settings_of_nonsense_are_not_resumed_from(tmp_path):
    settings = dataclasses.asdict(PPOConfig())
    header = {"config": settings | {"entropy_cost": "../../etc/passwd"}}
    path = save_checkpoint(tmp_path, {}, header, 1)
    with pytest.raises(CheckpointError, match="must be "):
        read_header(path, PPOConfig)
    path = save_checkpoint(tmp_path, {}, {"config": settings, "chunks": "2"}, 2)
    assert read_header(path, PPOConfig)["config"]["seed"] == 0
    with pytest.raises(CheckpointError, match="chunks"):
        read_header(path, PPOConfig, chunks=int)


def read(*arguments):
    return read_settings(PRESETS["cpu"], PRESETS, arguments, None, summaries())


def test_a_preset_gives_the_defaults_and_flags_change_them():
    assert read() == read("--preset", "auto") == PRESETS["cpu"]
    changed = read("--seed", "3", "--preset=square", "--env.num-agents", "6")
    env = dataclasses.replace(PRESETS["square"].env, num_agents=6)
    assert changed == dataclasses.replace(PRESETS["square"], seed=3, env=env)


def test_a_file_gives_settings_and_flags_win(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "preset: square\nlearning_rate: 1e-3\nhalf_precision: false\n"
        "env: {num_agents: 6, occupancy: [0.2, 0.8]}\nenv.sim.steering_delay: 0.2\n"
    )
    flags = ("--config", str(file))
    found = read(*flags, "--env.num-agents=5")
    assert (found.preset, found.num_lots) == ("square", PRESETS["square"].num_lots)
    assert (found.learning_rate, found.half_precision) == (1e-3, False)
    assert (found.env.num_agents, found.env.occupancy) == (5, (0.2, 0.8))
    assert found.env.sim.steering_delay == 0.2
    named = read("--preset", "gpu", *flags)  # instead of the file's
    assert (named.preset, named.minutes) == ("gpu", PRESETS["gpu"].minutes)


def test_the_settings_of_a_run_are_a_file_for_another(tmp_path):
    config = dataclasses.replace(PRESETS["dynamic"], seed=4, name="a")
    write_json(tmp_path / "config.json", describe(config))
    copied = shutil.copy(tmp_path / "config.json", tmp_path / "mine.json")
    assert read("--config", str(copied)) == dataclasses.replace(config, name="")
    flags = ("--config", str(tmp_path / "config.json"))
    assert read(*flags) == dataclasses.replace(config, name="")
    assert read(*flags, "--seed", "5").seed == 5
    with pytest.raises(ValueError, match="drop --preset"):
        read(*flags, "--preset", "cpu")
    with pytest.raises(ValueError, match="keeps its own settings: drop --config"):
        read(*flags, "--resume", str(tmp_path))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- a", "must have lines"),
        ("preset: cqu", "'cqu'"),
        ("env: {num_agent: 3}", "num.agent"),
        ("resume: runs/a", "resume"),
    ],
)
def test_a_file_of_nonsense_is_refused_by_its_name(text, said, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ValueError, match=said) as caught:
        read("--config", str(file))
    assert "mine.yaml" in str(caught.value)


def test_settings_need_to_fit_the_named_preset_only():
    # 8192 lots x 7 agents divide by 28, the default's 128 x 2 do not.
    assert read("--preset", "square", "--num-minibatches", "28").num_lots == 8192
    with pytest.raises(ValueError, match="256 must be a multiple of"):
        read("--num-minibatches", "28")


def test_curricula_of_a_preset_may_be_without_effect():
    alone = read("--preset", "anywhere", "--env.num-agents=1", "--env.min-agents=None")
    assert alone.curriculum == PRESETS["anywhere"].curriculum
    fixed = read("--preset", "hope", "--env.layout", "tpcap_1", "--lot-life", "0")
    assert fixed.curriculum.target_rate


def test_a_resumed_run_keeps_its_preset_and_takes_no_setting(tmp_path):
    config = dataclasses.replace(PRESETS["cpu"], seed=4)
    write_json(tmp_path / "config.json", describe(config))
    flags, default = ("--resume", str(tmp_path)), read()
    assert read(*flags, "--preset", "cpu").seed == 4
    assert read(*flags, "--time-limit", "3").seed == 4
    # Not even one that it has by its preset.
    same = f"--num-steps={default.num_steps}"
    for flag in ("--preset=square", same, f"--env.num-agents={default.env.num_agents}"):
        name = flag.partition("=")[0]
        with pytest.raises(ValueError, match=f"keeps its own settings: drop {name}"):
            read(*flags, flag)

"""Files of policies: pretrained ones with their cards, checkpoints, configs."""

import dataclasses
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.mutating import with_junk
from helpers.programs import assert_refused, exit_code
from helpers.sliding import sliding
from helpers.tiny_policy import TINY, parked_learner
from helpers.trees import same

import carpark_mj
from carpark_mj import pretrained
from carpark_mj.cli import evaluate
from carpark_mj.cli.driver import adapt, find_driver
from carpark_mj.config import GoalConfig, insert
from carpark_mj.env import ParkingEnv
from carpark_mj.layouts.clutter import ClutterConfig
from carpark_mj.layouts.standards import DesignCar
from carpark_mj.observations import make_fields, observation_size
from carpark_mj.policy import checkpoints, loading, runs
from carpark_mj.policy.checkpoints import CheckpointError
from carpark_mj.policy.loading import FOLDER_SETTINGS
from carpark_mj.policy.runs import find_policy
from carpark_mj.pretrained import pretrained_names
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.ppo.train import save

MAX_SIZE = 3.5e6  # bytes; three layers of 512 units behind 384 of own numbers, sets


def act(loaded, count=50):
    size = (count, observation_size(loaded.env))
    seen = np.random.default_rng(3).normal(size=size).astype(np.float32)
    return np.asarray(jax.jit(loaded.policy)(seen, jax.random.key(0))[0])


def test_a_policy_alone_acts_like_its_run(run, shipped):
    saved = loading.load_policy(shipped / "tiny.npz")
    ours = loading.load_policy(run)
    assert saved.env == ours.env == TINY.env
    np.testing.assert_array_equal(act(saved), act(ours))
    again = shipped / "again.npz"
    loading.save_policy("tiny", again)
    assert again.read_bytes() == (shipped / "tiny.npz").read_bytes()


def test_the_command_writes_a_policy_alone_or_nothing(run, shipped, tmp_path, capsys):
    out = tmp_path / "new" / "a.npz"
    assert exit_code("export", [str(run), "--out", str(out)]) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    assert out.read_bytes() == (shipped / "tiny.npz").read_bytes()
    for words, said in (
        (["nowhere", "--out", "b/a.npz"], "no run folder or checkpoint at nowhere"),
        (["tiny", "--out", "b/a.pb"], "pb'"),
        (["tiny", "--out", "/proc/a.npz"], "/proc/a.npz"),
    ):
        assert_refused(capsys, "export", words, said)
        assert not Path("b").exists()


def test_it_holds_nothing_that_only_training_needs(run, shipped):
    path = shipped / "tiny.npz"
    arrays = arrays_of(path)
    kinds = {re.match(r"\['(\w+)'\]|header", name)[1] for name in arrays}
    floats = [x.dtype for x in arrays.values() if x.dtype.kind == "f"]
    assert kinds == {None, "normalizer", "average"}  # the header is no array of a tree
    assert set(floats) == {np.dtype("float32")}
    assert path.stat().st_size < runs.latest_checkpoint(run).stat().st_size
    header = checkpoints.read_header(path)
    assert header["config"]["seed"] == 7
    assert not {*FOLDER_SETTINGS} & {*header["config"]}


def test_a_policy_is_found_by_name_and_a_path_is_a_path(shipped):
    assert carpark_mj.load_policy("tiny").path == shipped / "tiny.npz"
    for path in ("./tiny", Path("tiny")):
        with pytest.raises(
            CheckpointError, match="no run folder or checkpoint at tiny"
        ):
            loading.load_policy(path)
    Path("tiny").mkdir()
    with pytest.raises(
        CheckpointError, match=r"tiny is a .* and a path.*write \./tiny"
    ):
        loading.load_policy("tiny")
    for path in ("./tiny", Path("tiny")):
        with pytest.raises(CheckpointError, match="tiny holds no checkpoint"):
            loading.load_policy(path)


def arrays_of(path):
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


@pytest.mark.parametrize(
    ("part", "value"), [("normalizer", np.inf), ("average", np.nan)]
)
def test_weights_that_are_not_finite_do_not_drive(shipped, part, value):
    path = shipped / "tiny.npz"
    arrays = arrays_of(path)
    of_part = (name for name in arrays if name.startswith(f"['{part}']"))
    name = next(name for name in of_part if arrays[name].dtype == np.float32)
    arrays[name].flat[-1] = value
    np.savez_compressed(path, **arrays)
    with pytest.raises(CheckpointError, match=rf"numbers at .*{part}.* not finite"):
        loading.load_policy(path)


@pytest.mark.parametrize(
    ("flags", "folder"),
    [
        ({}, "runs/tiny"),
        ({"num_agents": 2, "rule": "strict"}, "runs/tiny"),  # as in its own task
        ({"num_agents": 1}, "runs/tiny/evaluations/num_agents-1"),
        ({"nominal": True}, "runs/tiny"),  # nothing to turn off
        ({"stochastic": True, "out": "mine"}, "mine"),
    ],
)
def test_evaluations_of_another_task_do_not_replace_the_own_one(shipped, flags, folder):
    *_, found = evaluate.prepare(evaluate.EvaluateConfig(run="tiny", **flags))
    assert found == Path(folder)
    assert not found.exists()  # made with its first file


def test_a_checkpoint_is_evaluated_beside_its_run(run):
    file = runs.latest_checkpoint(run)
    *_, folder = evaluate.prepare(evaluate.EvaluateConfig(run=str(file)))
    assert folder == run / "evaluations" / file.stem
    assert evaluate.prepare(evaluate.EvaluateConfig(run=str(run)))[-1] == run


def test_a_flat_network_drives_with_as_many_cars_only(tmp_path):
    flat = dataclasses.replace(TINY.networks, encoder="flat")
    config = dataclasses.replace(TINY, networks=flat)
    save(tmp_path / "flat", config, parked_learner(config).init())
    driver = find_driver(str(tmp_path / "flat"))
    env, reset, step = sliding(adapt(driver.env, layout="square_compact"))
    state, observation = reset(jax.random.key(0))
    action, _ = driver.policy(env)(observation, jax.random.key(0))
    assert np.isfinite(step(state, action)[1].observation).all()
    alone = ParkingEnv(adapt(driver.env, num_parked_cars=1))
    masks = [x for x in make_fields(TINY.env) if x.is_mask]
    count = sum(field.group == "parked_car" for field in masks)
    assert count > 1
    with pytest.raises(ValueError, match=rf"flat was .*parked_car {count}, here 1"):
        driver.policy(alone)


@pytest.mark.parametrize("name", ["anywhere", "square"])
@pytest.mark.parametrize(
    "counts",
    [
        {"tracked_agents": 0, "tracked_parked_cars": 0},
        {"tracked_agents": 3, "tracked_parked_cars": 1},
    ],
)
def test_a_kind_that_is_not_observed_is_an_empty_set(name, counts):
    own = loading.load_policy(name)
    env = insert(own.env, {f"observation.{key}": x for key, x in counts.items()})
    # All entities that `env` does not track are absent in the other observation.
    here, values = make_fields(env), {}
    for number, field in enumerate(here):
        values[field.name] = np.full(field.size, 0.1 + 0.01 * (number % 7))
        if field.is_mask:
            values[field.name][:] = 1.0
    vector, whole = (
        np.concatenate(
            [values.get(field.name, np.zeros(field.size)) for field in fields]
        )[None].astype(np.float32)
        for fields in (here, make_fields(own.env))
    )
    key = jax.random.key(0)
    expected, _ = own.policy(whole, key)
    found, _ = loading.load_policy(name, env=env).policy(vector, key)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    with pytest.raises(ValueError, match=f"not an observation of {vector.shape[-1]}"):
        own.policy(vector, key)


def test_other_observations_or_actions_are_refused(shipped):
    with pytest.raises(TypeError, match="env must be of EnvConfig or None, not 'squa"):
        loading.load_policy("tiny", env="square")

    def load(path, value):
        loading.load_policy("tiny", env=insert(TINY.env, {path: value}))

    with pytest.raises(ValueError, match=r"tiny was trained on other observations"):
        load("observation.rays.count", 32)
    with pytest.raises(ValueError, match="other observations"):  # as many numbers
        load("observation.rings.diameters", (5.0, 6.2, 9.0))
    with pytest.raises(ValueError, match="mover none, here"):
        load("observation.tracked_movers", 2)
    with pytest.raises(ValueError, match="tiny was trained"):
        load("goals", GoalConfig(dynamic=True))


def test_every_policy_is_small_and_acts(shipped):
    assert "tiny" in pretrained_names()
    for name in pretrained_names():
        assert find_policy(name).stat().st_size <= MAX_SIZE, name
        # In its own environment, which may take minutes to compile: not driven there.
        action = act(loading.load_policy(name))
        assert np.isfinite(action).all(), name
        assert (np.abs(action[:, :2]) <= 1.0).all(), name


DOCS = Path(__file__).parents[2] / "docs"


def faults(name, card):
    """What is wrong with the card of a policy."""
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in card.splitlines()
        if line.startswith("|") and not line.startswith("|---") and line != "| | |"
    ]
    settings = {row[0]: row[1] for row in cells if len(row) == 2}
    evaluations = [row for row in cells if len(row) == 5][1:]
    header = checkpoints.read_header(find_policy(name))
    wanted = ("task", "training", "steps", "seed", "device")
    yield from (f"no {row}" for row in wanted if not settings.get(row))
    if not re.search(r"^Limits:\n\n(- \S.*\n( .*\n)*)+\Z", card, re.MULTILINE):
        yield "no limits"
    if card.splitlines()[0] != f"## {name}":
        yield "another name"
    if settings.get("steps") != f"{header['env_steps']:,}":
        yield f"steps are {header['env_steps']:,}"
    if settings.get("seed") != str(header["config"]["seed"]):
        yield f"the seed is {header['config']['seed']}"
    if not evaluations:
        yield "no evaluation"
    for command, episodes, *rates in evaluations:
        if f"`python eval/evaluate.py {name}" not in command:
            yield f"{command} is no evaluation of it"
        if int(episodes.replace(",", "")) < 1000:
            yield f"{episodes} episodes are too few"
        pattern = r"([\d.]+) % \(([\d.]+) … ([\d.]+)\)"
        numbers = [list(map(float, re.fullmatch(pattern, r).groups())) for r in rates]
        if not all(low <= rate <= high for rate, low, high in numbers):
            yield f"a rate is not in its interval: {rates}"
        if abs(sum(rate for rate, _, _ in numbers) - 100) > 0.2:  # diverged, rounding
            yield f"{rates} do not make 100 %"


def test_every_policy_has_a_card_with_its_figures():
    cards = {path.stem: path.read_text() for path in pretrained.FOLDER.glob("*.md")}
    assert cards.keys() == {*pretrained_names()}
    for name, card in cards.items():
        assert list(faults(name, card)) == [], name


def test_the_page_of_the_policies_shows_all_cards():
    """All lines of the cards, but those of the training."""
    cards = "\n".join(
        (pretrained.FOLDER / f"{name}.md").read_text() for name in pretrained_names()
    )
    hidden = r"(?m)^\| (first training|training|steps|seed|device) \|.*\n"
    expected = re.sub(hidden, "", cards)
    page = (DOCS / "policies.md").read_text()
    shown = page.split("<!-- cards -->\n")[1].split("\n<!-- end of cards -->")[0]
    assert shown == expected.rstrip(), f"paste this:\n{expected}"


# Checkpoints and configs


# Writes a checkpoint, and is killed before the file has its name.
KILLED = """
import os, pathlib, sys
from carpark_mj.policy import runs
os.fsync = lambda file: os.kill(os.getpid(), 9)
runs.save_checkpoint(pathlib.Path(sys.argv[1]), {}, {}, 10)
"""


def tree():
    return {
        "weights": {"kernel": jax.random.normal(jax.random.key(3), (4, 5))},
        "count": jnp.array(7, jnp.int32),
        "keys": jax.random.split(jax.random.key(1), 3),
        "flags": jnp.array([True, False]),
    }


def test_a_round_trip_is_exact_and_keeps_keys_and_header(tmp_path):
    path = tmp_path / "a.npz"
    checkpoints.save(path, tree(), {"steps": 12})
    loaded = checkpoints.load(path, jax.eval_shape(tree))
    assert same(loaded, tree())
    draws = [jax.random.uniform(t["keys"][2]) for t in (loaded, tree())]
    assert draws[0] == draws[1]
    assert checkpoints.read_header(path)["steps"] == 12
    part = {"weights": tree()["weights"]}  # can be read alone
    assert same(checkpoints.load(path, part), part)
    with np.load(path, allow_pickle=False) as file:
        assert {file[name].dtype.kind for name in file.files} <= set("fiub")


def test_foreign_and_truncated_files_are_refused_by_name(tmp_path):
    text, archive, array, cut = (tmp_path / n for n in ("a.txt", "b.npz", "c.npy", "d"))
    text.write_text("hello")
    np.savez(archive, x=np.zeros(3))
    np.save(array, np.zeros(3))
    checkpoints.save(cut, tree(), {})
    data = cut.read_bytes()
    others = (text, archive, array, tmp_path / "missing.npz")
    for path, size in zip((*others, *3 * [cut]), (*4 * [0], 0, 100, -50), strict=True):
        cut.write_bytes(data[:size])
        with pytest.raises(CheckpointError, match=path.name) as caught:
            checkpoints.load(path, tree())
        assert "\n" not in str(caught.value)


def test_misfits_name_the_array_and_both_shapes(tmp_path):
    path = tmp_path / "a.npz"
    checkpoints.save(path, tree(), {})
    with pytest.raises(CheckpointError, match=r"kernel.*\[4, 5\].*\[4, 6\]"):
        checkpoints.load(path, {"weights": {"kernel": jnp.zeros((4, 6))}})
    with pytest.raises(CheckpointError, match=r"lacks.*bias"):
        checkpoints.load(path, {"weights": {"bias": jnp.zeros(5)}})


def test_the_last_two_checkpoints_are_kept_and_no_abandoned_one(tmp_path):
    paths = [runs.save_checkpoint(tmp_path, {}, {}, step) for step in (10, 200, 3000)]
    assert paths[2].name == "step_000000003000.npz"
    assert runs.checkpoint_files(tmp_path) == paths[1:]
    newest = runs.save_checkpoint(tmp_path, {}, {}, 1500)  # the run went back
    assert runs.checkpoint_files(tmp_path) == [paths[1], newest]
    assert runs.latest_checkpoint(tmp_path) == newest


def test_what_a_killed_process_has_left_is_no_checkpoint(tmp_path):
    killed = subprocess.run([sys.executable, "-c", KILLED, tmp_path], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert len([*(tmp_path / "checkpoints").iterdir()]) == 1
    assert runs.checkpoint_files(tmp_path) == []
    path = runs.save_checkpoint(tmp_path, tree(), {}, 20)
    assert runs.checkpoint_files(tmp_path) == [path]


def test_the_newest_readable_checkpoint_is_found(tmp_path):
    for folder, said in ((tmp_path, "holds no checkpoint"), (tmp_path / "x", "x")):
        with pytest.raises(CheckpointError, match=said):
            runs.latest_checkpoint(folder)
    for step in (1, 2):
        newest = runs.save_checkpoint(tmp_path, tree(), {"step": step}, step)
    newest.write_bytes(b"PK half")
    path = runs.latest_checkpoint(tmp_path)
    assert checkpoints.read_header(path)["step"] == 1
    path.write_bytes(b"")
    with pytest.raises(CheckpointError, match=newest.name):
        runs.latest_checkpoint(tmp_path)


@pytest.mark.parametrize("name", [*sorted(PRESETS), None])
def test_a_config_survives_json(name):
    configs = [ClutterConfig(largest=car) for car in (None, DesignCar())]
    if name:
        configs = [dataclasses.replace(PRESETS[name], seed=5, learning_rate=1e-3)]
    for config in configs:
        text = json.dumps(dataclasses.asdict(config))
        assert runs.from_dict(type(config), json.loads(text)) == config


def test_an_older_checkpoint_is_refused_before_it_is_read(tmp_path):
    header = {"config": {"env": {"gone": 1}}, "env_steps": 8}
    path = runs.save_checkpoint(tmp_path / "x", {"a": np.zeros(1)}, header, 8)
    for run in (tmp_path / "x", path):
        with pytest.raises(CheckpointError, match="unusable config"):  # not its age
            loading.load_policy(run)
    checkpoints.save(path, {"a": np.zeros(1)}, header)
    for run in (tmp_path / "x", path):
        with pytest.raises(CheckpointError, match=r"is of another carpark"):
            loading.load_policy(run)


def test_settings_with_junk_are_a_config_or_refused():
    data = dataclasses.asdict(PRESETS["anywhere"])
    for seed in range(300):
        try:
            config = runs.from_dict(PPOConfig, with_junk(data, seed))
        except ValueError:
            continue
        hash(config)  # so nowhere a list or a dictionary
        again = json.loads(json.dumps(dataclasses.asdict(config)))
        assert runs.from_dict(PPOConfig, again) == config

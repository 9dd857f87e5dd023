"""Extensions as their users have them: the packages of `examples/extensions`, six of
them in one training, so that they are seen to go together, and one by hand."""

import json
import os

import pytest
from helpers.programs import ROOT, python, rows_of

from carpark_mj.training import Run

pytestmark = pytest.mark.slow

PACKAGES = ROOT / "examples" / "extensions"
NAMES = sorted(path.name for path in PACKAGES.iterdir() if path.is_dir())
TOGETHER = ("court", "haste", "nearest_wall", "peak_lateral", "rail_cart", "taxi")
# Three updates of PPO.
TRAIN = (
    *("train", "--name", "tiny", "--preset", "cpu", "--video-seconds", "0"),
    *("--num-lots", "4", "--num-minibatches", "2", "--env.num-parked-cars", "2"),
    *("--networks.policy-layers", "16", "--networks.value-layers", "16"),
)
FLAGS = (
    *("--env.layout", "court,street", "--env.vehicle", "taxi"),
    *("--env.reward.extra.haste", "0.01", "--env.reward.extra.haste.above", "0.5"),
    *("--env.observation.encoding", "nearest_wall"),
    *("--env.observation.rays.count", "4", "--env.metrics.extra", "peak_lateral"),
    *("--env.movers", "rail_cart", "--env.physics", "bicycle"),
    # So that episodes end.
    *("--unroll-length", "64", "--num-steps", "1536", "--minutes", "0"),
    *("--env.episode.max-steps", "30", "--eval-episodes", "8"),
)


def command(folders, extensions, *arguments):
    """Runs `carpark_mj` where packages can be imported and extensions are named."""
    path = os.pathsep.join(map(str, [ROOT, *folders]))
    given = {"CARPARK_MJ_EXTENSIONS": ",".join(extensions), "COLUMNS": "200"}
    return python("-m", "carpark_mj", *arguments, PYTHONPATH=path, **given)


def run(extensions, *arguments):
    """What the command says with some of the packages."""
    folders = [PACKAGES / name for name in extensions]
    done = command(folders, extensions, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def refused(extensions, *arguments):
    """Why it refuses, in a line, though all packages can be imported."""
    done = command([PACKAGES / name for name in NAMES], extensions, *arguments)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    return done.stderr


def evaluated(extensions, policy, folder, *flags):
    """What an evaluation writes."""
    run(extensions, "evaluate", policy, *flags, "--out", folder)
    return json.loads((folder / "evaluation.json").read_text())


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The folder of a few updates with six packages, evaluated."""
    folder = tmp_path_factory.mktemp("runs")
    run(TOGETHER, *TRAIN, *FLAGS, "--runs-dir", folder)
    return folder / "tiny"


def test_a_reward_term_and_a_metric_are_in_the_log_of_a_training(trained):
    rows = Run(trained).metrics
    assert len(rows) == 3
    assert all(row["reward/haste"] < 0.0 for row in rows)
    assert rows[-1]["episode/return_haste"] < 0.0
    assert rows[-1]["episode/peak_lateral"] > 0.0


def test_they_and_the_layouts_are_in_an_evaluation(trained):
    found = json.loads((trained / "evaluation.json").read_text())
    summary = found["summary"]
    assert {*found["families"]} <= {"court", "street"}
    assert summary["peak_lateral"]["max"] >= summary["peak_lateral"]["median"] > 0.0
    assert summary["mean_returns"]["haste"] < 0.0
    rows = rows_of(trained / "evaluation.csv")
    most = max(float(row["peak_lateral"]) for row in rows)
    assert most == pytest.approx(summary["peak_lateral"]["max"])


def test_the_policy_is_read_back_with_them_and_refused_without(trained, tmp_path):
    assert evaluated(TOGETHER, trained, tmp_path / "found", "--episodes", "8")
    for missing in ("haste", "taxi"):
        others = [name for name in TOGETHER if name != missing]
        said = refused(others, "evaluate", trained)
        assert "unknown" in said
        assert repr(missing) in said


def test_a_policy_of_a_back_end_is_read_back_and_refused_by_others(tmp_path):
    flags = ("--unroll-length", "4", "--num-steps", "96", "--eval-episodes", "0")
    flags += ("--env.physics", "hover", "--runs-dir", tmp_path)
    run(("hover",), *TRAIN, *flags)
    policy = tmp_path / "tiny"
    assert evaluated(("hover",), policy, tmp_path / "found", "--episodes", "8")
    others = ("evaluate", policy, "--physics", "mjx")
    assert "other actions" in refused(("hover",), *others)
    assert "unknown physics 'hover'" in refused((), "evaluate", policy)


LOT = {
    "format": "carpark_mj layout 1",
    "bays": [{"pose": [0.0, 0.0, 0.0], "size": [5.5, 2.8]}],
    "spawns": [{"pose": [-9.0, 0.5, 0.0], "size": [1.0, 1.0], "spread": 0.1}],
    "extent": [15.0, 6.0],
}


def test_a_planner_parks_where_the_way_is_free_and_is_shown(tmp_path):
    path, still = tmp_path / "lot.json", tmp_path / "still.png"
    path.write_text(json.dumps(LOT))
    lot = ("--layout", path, "--num-agents", "1", "--num-parked-cars", "0")
    planner = ("pure_pursuit",)
    found = evaluated(planner, *planner, tmp_path / "found", "--episodes", "64", *lot)
    assert found["summary"]["parked"]["rate"] > 0.9
    run(planner, "render", *planner, "--frame", "10", *lot, "--out", still)
    assert still.stat().st_size > 10_000
    assert "pure_pursuit" in refused((), "evaluate", *planner, "--episodes", "8")


MODULE = """
from carpark_mj.extensions import Entry
from carpark_mj.programs import STUDY_PROGRAMS
from carpark_mj.training.ppo.parts import PRESETS, VARIANTS

PRESETS.register("tiny", Entry("tiny_parts:TINY", "of another package"))
VARIANTS.register("halved", Entry("tiny_parts:HALVED"))
STUDY_PROGRAMS.register("hello", Entry("tiny_parts:hello", "greet"))
"""
PARTS = """
import jax

from carpark_mj.config import EnvConfig
from carpark_mj.policy.networks import NetworkConfig
from carpark_mj.training import PPOConfig
from carpark_mj.training.ppo.variants import Variant


class Halved(Variant):
    def loss(self, *arguments):
        loss, said = super().loss(*arguments)
        return loss / 2, said | {"halved": loss / 2}


HALVED = Halved()
TINY = PPOConfig(
    preset="tiny",
    num_steps=64,
    num_lots=4,
    unroll_length=4,
    num_minibatches=2,
    variant="halved",
    eval_episodes=0,
    video_seconds=0.0,
    networks=NetworkConfig((8,), (8,)),
    env=EnvConfig(physics="bicycle", num_parked_cars=2),
)


def hello(arguments):
    print("hello", *arguments)
"""
METADATA = "Metadata-Version: 2.1\nName: tiny\nVersion: 1.0\n"


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A folder with the package's modules."""
    folder = tmp_path_factory.mktemp("package")
    (folder / "tiny_extension.py").write_text(MODULE)
    (folder / "tiny_parts.py").write_text(PARTS)
    return folder


def test_a_named_module_s_preset_and_variant_train(package, tmp_path):
    flags = ("--preset", "tiny", "--runs-dir", tmp_path, "--name", "tiny")
    done = command([package], ["tiny_extension"], "train", *flags)
    assert done.returncode == 0, done.stderr
    rows = Run(tmp_path / "tiny").metrics
    assert [row["update"] for row in rows] == [1, 2]
    for row in rows:
        assert row["loss/halved"] == pytest.approx(row["loss/total_loss"] / 2)


def test_an_installed_package_is_listed_and_runs(package):
    """As pip leaves it: it names its module as an entry point."""
    metadata = package / "tiny-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(METADATA)
    points = "[carpark_mj.extensions]\ntiny = tiny_extension\n"
    (metadata / "entry_points.txt").write_text(points)
    done = command([package], (), "study", "hello", "you")
    assert (done.stdout, done.stderr) == ("hello you\n", "")
    assert "\n  hello " in command([package], (), "study").stdout
    said = command([package], (), "list", "presets").stdout
    assert "of another package, " in said

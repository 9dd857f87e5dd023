"""`carpark_mj study junction`: which loop trains what, refusals and verdicts."""

import json

import pytest
from helpers.programs import assert_refused

from carpark_papers.cederle import speed
from carpark_papers.cederle.benchmarl.config import BenchMARLConfig
from carpark_papers.cederle.dqn.config import DQNConfig
from carpark_papers.cederle.training import program as junction
from carpark_papers.cederle.training.config import Algorithm
from carpark_papers.cederle.training.evaluations import (
    WINDOW,
    summary,
    verdict,
    write_evaluations,
)
from carpark_papers.cederle.training.families import presets_of, read_junction_settings


@pytest.mark.parametrize("algorithm", Algorithm.__args__)
def test_every_algorithm_has_a_loop_and_presets_of_its_own(algorithm):
    config = read_junction_settings(["--algorithm", algorithm], None)
    assert config == presets_of(algorithm)["parallel"]
    deep_q = algorithm in ("idqn", "double", "dueling", "double-dueling")
    assert type(config) is (DQNConfig if deep_q else BenchMARLConfig)
    assert config.algorithm == algorithm
    assert config.default_name == f"{algorithm}-2av-0"
    study = presets_of(algorithm).get("cederle")
    assert (study is None) == (algorithm in ("ippo", "mappo"))


def test_a_resumed_run_keeps_its_algorithm(tmp_path):
    from carpark_mj.training.run_folder import describe

    config = read_junction_settings(["--algorithm", "vdn", "--seed", "3"], None)
    (tmp_path / "config.json").write_text(json.dumps(describe(config)))
    resumed = read_junction_settings(["--resume", str(tmp_path)], None)
    assert (resumed.algorithm, resumed.seed) == ("vdn", 3)
    assert type(resumed) is BenchMARLConfig


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--scenario", "4av"], ["4av", "3av-hd"]),
        (["--algorithm", "ppo"], ["ppo", "double-dueling", "qmix"]),
        (["--algorithm", "idqn", "--action", "scalar"], ["idqn", "index", "scalar"]),
        (["--algorithm", "qmix", "--action", "scalar"], ["qmix", "index", "scalar"]),
        (["--algorithm", "maddpg", "--action", "index"], ["maddpg", "--action scalar"]),
        (["--algorithm", "mappo", "--preset", "cederle"], ["mappo", "study"]),
        (["--algorithm", "vdn", "--observation", "image"], ["vdn", "vector", "image"]),
        (["--observation", "image", "--pixels", "20"], ["pixels", "36", "20"]),
        (["--buffer-size", "10"], ["buffer_size", "at least 128", "10"]),
        (["--eval-jitter", "20"], ["jitter", "at most", "20"]),
        (["--algorithm", "ippo", "--unroll", "1"], ["batch_size", "at most 256"]),
        (["--algorithm", "ippo", "--max-steps", "99"], ["multiple of repeat", "99"]),
        (["--algorithm", "vdn", "--epsilon-start", "0"], ["at least", "0.05", "0.0"]),
        (["--resume", "nowhere"], ["no run at nowhere"]),
    ],
)
def test_bad_input_is_refused_in_one_line(flags, words, capsys):
    line = assert_refused(capsys, junction, flags, words[0])
    assert all(word in line for word in words), line


def rows(*returns):
    rates = {"crashed": 0.25, "completed": 0.75, "west_before_east": 0.75}
    return [
        {"env_steps": 10 * k, "return": value, "solved": int(value >= 100), **rates}
        for k, value in enumerate(returns)
    ]


@pytest.mark.parametrize(
    ("returns", "solved_at", "converged_at"),
    [
        ([0] * 9, None, None),
        ([0, 0, 101, 0, 0, 0, 0, 0], 20, None),  # once is not for good
        ([0, 110] + [110] * 5, 10, 50),  # the mean of five evaluations counts
        ([110] * 3, 0, None),  # too few to say
        ([110] * 5 + [0] * 5 + [110] * 6, 0, 140),
        # 99 among them does no harm, as long as the mean stays.
        ([0, 110, 110, 110, 110, 110, 99, 110], 10, 50),
    ],
)
def test_solved_once_is_not_converged(returns, solved_at, converged_at):
    found = verdict(DQNConfig(), rows(*returns))
    assert WINDOW == 5
    assert (found["solved_at"], found["converged_at"]) == (solved_at, converged_at)


def test_evaluations_are_written_and_summed_up(tmp_path):
    config = BenchMARLConfig(scenario="3av")
    write_evaluations(tmp_path, config, rows(0, 130.5, 99))
    found = json.loads((tmp_path / "evaluation.json").read_text())
    assert (found["threshold"], found["best_return"]) == (120.0, 130.5)
    assert found["last"]["env_steps"] == 20
    assert (tmp_path / "evaluations.csv").read_text().count("\n") == 4
    assert (tmp_path / "learning_curve.png").exists()
    words = summary(found)
    assert "mappo, 3av: solved at step 10, not converged" in words
    assert "crashed 25.0%" in words
    assert "west before east 75%" in words


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--junctions", "0"], "junctions must be at least 1, not 0"),
        (["--scenario", "9av"], "unknown scenario '9av'; choose from"),
        (["--cars"], "cars must name at least one"),
    ],
)
def test_speed_is_not_measured_of_what_does_not_exist(flags, said, capsys):
    assert_refused(capsys, speed, flags, said)

"""The study's figures: all listed, trainable, beside the published numbers."""

import functools
import math
import statistics

import pytest
from helpers.programs import assert_refused, exit_code
from helpers.sweeping import train

from carpark_mj import sweeps
from carpark_mj.analysis import Record, group
from carpark_mj.evaluation.catalogue import metrics
from carpark_mj.sweeps import Outcome, open_sweep, run_sweep, write_outcome
from carpark_mj.sweeps.plan import checked_runs, runs, settings_of
from carpark_mj.training.run_folder import list_settings
from carpark_papers.tanner.experiments import program as study
from carpark_papers.tanner.experiments.figures import (
    ELSEWHERE,
    EXPERIMENTS,
    FIGURES,
    experiment_of,
    plan_of,
    published_runs,
    published_values,
    verdict,
)
from carpark_papers.tanner.experiments.program import Cost, choose, cost, measured_rate

EACH = pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda e: e.name)


@pytest.fixture(autouse=True)
def stubs(monkeypatch):
    """Runs are noted, not trained, in this process, whose JAX is running."""
    monkeypatch.setattr(sweeps, "prepare", lambda cluster: None)
    monkeypatch.setattr(sweeps, "run_sweep", functools.partial(run_sweep, train=train))


def test_every_figure_is_a_sweep_or_says_what_it_is(capsys):
    swept = [figure for experiment in EXPERIMENTS for figure in experiment.figures]
    assert sorted([*swept, *ELSEWHERE]) == sorted(FIGURES)
    assert exit_code(study, ["--list"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == [f"5.{number}" for number in range(1, 21)]


@EACH
def test_its_runs_can_be_trained_and_are_as_many_as_published(experiment):
    assert len(plan_of(experiment)) == len(published_runs(experiment.figures))
    combinations = checked_runs(plan_of(experiment, repeats=1))
    config = settings_of(combinations[-1])
    assert config.eval_episodes > 1000
    assert config.env.physics == "grid"


@EACH
def test_its_runs_meet_published_ones_at_the_same_points(experiment):
    ours = [
        Record(run.name, dict(list_settings(settings_of(run))), {})
        for run in runs(plan_of(experiment, repeats=1))
    ]
    sources = {"ours": ours, "published": published_runs(experiment.figures)}
    points = group(sources, experiment.fields)
    values = {name: {p.values for p in points if p.source == name} for name in sources}
    assert values["ours"] == values["published"]


@EACH
def test_its_metrics_are_measured_here_and_published(experiment):
    assert {*experiment.metrics} <= {metric.name for metric in metrics()}
    for record in published_runs(experiment.figures):
        for metric in experiment.metrics:
            assert metric in record.metrics


@pytest.mark.parametrize(
    ("figures", "settings", "metric", "value"),
    [  # of the thesis' text and tables
        (("5.4",), {"discount": "0.9998"}, "crashed", 0.0204),
        (("5.5",), {"env.num_agents": "1"}, "parked", 0.3093),
        (("5.5",), {"env.num_agents": "2"}, "nearest_car", 15.4468 * 0.5625),
        (("5.8",), {"env.observation.tracked_cars": "0"}, "parked", 0.4912),
        (("5.14",), {"env.num_agents": "7"}, "speed", 12.4196 * 0.5625 / 16 / 0.2),
        (
            ("5.10", "5.11"),
            {"env.reward.extra.smoothness": "0"},
            "yaw_rate",
            1.2825 * math.radians(15) / 0.2,
        ),
        (
            ("5.18", "5.19", "5.20"),
            {"env.giving_way.scheme": "G,G,A", "env.giving_way.bad_goal": "-0.1"},
            "conformity_global_same",
            0.9761,
        ),
    ],
)
def test_published_numbers_are_those_of_the_thesis(figures, settings, metric, value):
    found = [
        record.metrics[metric]
        for record in published_runs(figures)
        if settings.items() <= record.settings.items()
    ]
    assert statistics.fmean(found) == pytest.approx(value, rel=1e-3, abs=5e-5)


def test_all_329_published_runs_are_there():
    assert sum(len(published_runs(e.figures)) for e in EXPERIMENTS) == 329
    assert published_values(("5.8",), "env.observation.tracked_cars") == tuple("01234")


def test_schemes_change_what_agents_see():
    seen = {
        dict(run.settings)["env.giving_way.scheme"]: settings_of(
            run
        ).env.observation.global_information
        for run in checked_runs(plan_of(experiment_of("5.19")))
    }
    assert len(seen) == 6
    assert all(value == name.startswith("G") for name, value in seen.items())


@pytest.mark.parametrize(
    ("ours", "theirs", "said"),
    [
        ([0.9, 0.91, 0.92], [0.9, 0.905, 0.93], "agrees"),
        ([0.9, 0.91, 0.92], [0.5, 0.51, 0.52], "differs: more"),
        ([0.1, 0.11, 0.12], [0.5, 0.51, 0.52], "differs: less"),
        ([0.5, 0.5, 0.5], [0.5, 0.5, 0.5], "agrees"),
        ([0.9, 0.91], [0.5, 0.51, 0.52], "not decided: 2 of ours"),
        ([0.9, 0.91, 0.92], [0.905], "not decided: 1 published, within ours"),
        ([0.9, 0.91, 0.92], [0.5], "not decided: 1 published, outside ours"),
        ([0.9, 0.91, 0.92], [0.91, 0.95], "not decided: 2 published, outside ours"),
        ([math.nan], [0.5], "not decided: not run"),
        ([0.5], [], "not published"),
    ],
)
def test_a_verdict_needs_three_runs_of_each(ours, theirs, said):
    assert verdict(ours, theirs) == said


def test_a_budget_goes_to_few_programs_first_and_names_the_rest():
    programs, minutes = (3, 2, 3, 1), (10, 30, 5, 2)
    costs = [
        Cost(experiment, 3, 3, n, m)
        for experiment, n, m in zip(EXPERIMENTS, programs, minutes, strict=False)
    ]
    chosen, rest = choose(costs, 20.0)
    assert [one.minutes for one in chosen] == [2, 10, 5]
    assert [one.minutes for one in rest] == [30]
    assert choose(costs, 0.0)[1] == []
    assert choose(costs, 24.0, at_once=2)[1] == []


def test_what_is_done_costs_nothing_and_says_how_fast_this_machine_is(tmp_path):
    experiment = experiment_of("5.8")
    plan = plan_of(experiment)
    each = checked_runs(plan)
    open_sweep(tmp_path, plan, True)
    before = cost(experiment, each, tmp_path, 16e6)
    assert (before.left, before.minutes) == (15, pytest.approx(15 / 60))
    write_outcome(tmp_path, each[0], Outcome("done", "", 32.0))
    assert cost(experiment, each, tmp_path, 16e6).left == 14
    assert measured_rate([(tmp_path, each)]) == pytest.approx(0.5e6)


def test_a_figure_leaves_its_page_with_published_runs_and_verdicts(tmp_path, capsys):
    flags = ["--figure", "5.8", "--runs-dir", str(tmp_path), "--cluster", "debug"]
    assert exit_code(study, [*flags, "--set", "num_steps=1000"]) == 0
    folder = tmp_path / "figure-5.8"
    page = (folder / "report.html").read_text()
    assert "Tanner 2022" in page
    verdicts = (folder / "verdicts.md").read_text()
    # Ours park half of the time; published 0.49 with no tracked car, 0.98 with one.
    lines = [line for line in verdicts.splitlines() if line.startswith("| parked | 1")]
    assert lines == [
        "| parked | 1 | 0.5 (0.5 to 0.5, 3 runs) | 0.9803 (0.9773 to 0.9822, 3 runs) "
        "| differs: less |"
    ]
    assert (folder / "parked.png").exists()
    assert "15 done" in capsys.readouterr().out


def test_what_exceeds_the_budget_is_not_run(tmp_path, capsys):
    flags = ["--all", "--minutes", "0.01", "--runs-dir", str(tmp_path)]
    assert exit_code(study, [*flags, "--cluster", "debug"]) == 0
    said = capsys.readouterr().out
    assert said.count("leaves out figure") == len(EXPERIMENTS)
    assert "leaves out figure 5.18, 5.19, 5.20: 48 of 48 runs in 6 programs" in said
    assert f"{len(EXPERIMENTS)} experiments do not fit 0.01 minutes" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ([], "give one of --figure NUMBER, --all and --list"),
        (["--all", "--list"], "give one of"),
        (["--figure", "5.21"], "unknown figure '5.21'; choose from 5.1, 5.2"),
        (["--figure", "5.1"], "figure 5.1 is not a sweep; tabular: carpark_mj study"),
        (["--all", "--minutes", "-1"], "minutes must be at least 0, not -1"),
        (["--figure", "5.8", "--set", "num_steps=1,2"], "set takes one value each"),
        (["--figure", "5.8", "--set", "tracked_cars=1"], "is given twice"),
        (["--figure", "5.8", "--set", "steps=1"], "unknown setting 'steps'"),
    ],
)
def test_bad_input_is_one_sentence(flags, said, capsys):
    assert_refused(capsys, study, flags, said)

"""The experiments in slots, and the numbers on their page."""

import subprocess
import sys

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env
from helpers import environment_pages as pages

from carpark_papers.pandita.experiments.report import (
    KINDS,
    draw_curves,
    final_success,
    verdict,
    write_curves,
    write_report,
)
from carpark_papers.pandita.experiments.slots import (
    EXPERIMENTS,
    Claim,
    make_job,
    slots_experiment,
)
from carpark_papers.pandita.sac.config import SACConfig
from carpark_papers.pandita.slots_env import SLOTS_OPTIONS, SlotsEnv
from carpark_papers.pandita.task import PANDITA


def test_the_twelve_can_be_trained_and_have_their_budgets():
    names = [experiment.name for experiment in EXPERIMENTS]
    assert names[:12] == [str(number) for number in range(1, 13)]
    assert len({*names}) == len(names)
    for experiment in EXPERIMENTS:
        config = SACConfig(phases=experiment.phases(1.0), replay=experiment.replay)
        assert {*config.kinds} <= {*KINDS}
        assert bool(experiment.claims) == experiment.name.isdigit()
    assert slots_experiment("10").phases(1.0) == ("slots:18750", "slots_diagonal:18750")
    assert slots_experiment("2").phases(0.1) == ("slots:1500",)


def test_experiments_that_train_alike_share_a_run_and_no_others(tmp_path):
    def job(name, preset="study", scale=1.0, seed=0):
        return make_job(slots_experiment(name), preset, scale, seed, tmp_path)

    assert job("2").folder == job("4").folder
    assert job("7").folder == job("9").folder
    others = [job(name) for name in ("2", "7", "10", "rehearsal-5", "clear")]
    others += [job("rehearsal-20"), job("10", seed=1), job("2", seed=1)]
    others += [job("2", "pandita"), job("2", scale=2.0), job("2", "pandita", 2.0)]
    for part in ("folder", "log"):
        assert len({getattr(one, part) for one in others}) == len(others)


def test_a_job_begins_a_run_and_then_continues_it(tmp_path):
    job = make_job(slots_experiment("clear"), "study", 1.0, 3, tmp_path)
    begin = job.command(2.5)
    assert begin[-2:] == ["--time-limit", "2.50"]
    assert begin[begin.index("--seed") + 1] == "3"
    assert begin[begin.index("--at-switch") + 1] == "clear"
    assert "--resume" not in begin
    job.folder.mkdir()
    (job.folder / "config.json").touch()
    program = begin.index("sac") + 1
    assert job.command(1.0)[program:] == [
        *("--resume", str(job.folder), "--time-limit", "1.00")
    ]


@pytest.mark.parametrize(
    ("claims", "vertical", "expected"),
    [
        ([Claim("slots", True)], [1, 1, 1, 1, 0], "agrees"),
        ([Claim("slots", True)], [1, 1, 0, 1, 0], "differs: slots mixed"),
        ([Claim("slots", False)], [1, 1, 1, 1, 1], "differs: slots parks"),
        ([Claim("slots", False)], [0, 0, 0, 0, 0], "agrees"),
        ([Claim("slots", True)], [0, 0, 0, 0, 0], "differs: slots fails"),
        ([Claim("slots", True)], [1, 1, 1], "not decided: 3 seeds"),
        ([], [1, 1, 1], "not tried in the thesis"),
    ],
)
def test_verdicts_need_seeds_that_agree(claims, vertical, expected):
    assert verdict(claims, {"slots": vertical}) == expected


def test_the_table_has_what_is_left_after_the_last_phase(tmp_path):
    def row(phase, kind, policy, success):
        return {"phase": phase, "kind": kind, "policy": policy, "success": success}

    run = [
        row(phase, kind, policy, float(kind == ("", *KINDS)[phase]))
        for phase in range(3)
        for kind in KINDS
        for policy in ("deterministic", "sampled")
    ]
    assert final_success([run], "sampled") == dict(
        zip(KINDS, ([0.0], [1.0], [0.0]), strict=True)
    )
    path = tmp_path / "report.md"
    write_report(path, {slots_experiment("10"): [run] * 5})
    line = path.read_text().splitlines()[2]
    assert "| 100% (57% to 100%), sampled 100% |" in line
    assert line.endswith("| -1.00 | agrees |")


def test_curves_have_a_line_for_each_run_and_the_ends_of_phases(tmp_path):
    runs = {}
    for name, count in (("2", 2), ("10", 1)):
        runs[slots_experiment(name)] = [tmp_path / f"{name}-{k}" for k in range(count)]
    header = "update,env_steps,episodes,episode/success"
    for folder in [folder for folders in runs.values() for folder in folders]:
        folder.mkdir()
        # Nothing ended in the first update; its rate is not a rate.
        rows = ["1,1000,0,0.5", "2,2000,10,0.0", "3,4000,30,0.4"]
        (folder / "metrics.csv").write_text("\n".join([header, *rows, ""]))
    panels = draw_curves(runs).axes
    assert [len(axes.lines) for axes in panels[:2]] == [2, 1 + 1]
    for line in panels[0].lines:
        assert list(line.get_xdata()) == [2.0, 4.0]
        assert list(line.get_ydata()) == pytest.approx([0.0, 0.3])  # by episodes
    assert [axes.axison for axes in panels] == [True, True, False, False]
    switch = panels[1].lines[-1].get_xdata()
    assert list(switch) == [2.0, 2.0]  # half of the steps each
    path = write_curves(tmp_path / "curves.png", runs)
    assert path.read_bytes().startswith(b"\x89PNG")


NAME = "carpark_mj/Slots-v0"
TEXT = pages.read("slots")
DEFAULTS = {
    "config": "pandita",
    "layout": PANDITA.layout,
    "parked_cars": PANDITA.num_parked_cars,
    "max_episode_steps": PANDITA.episode.max_steps,
    **dict.fromkeys(("discrete", "details"), False),
}


@pytest.mark.parametrize(
    ("marker", "expected"),
    [
        ("summary", pages.summary),
        ("observation", pages.observation),
        ("rewards", pages.pose),
    ],
)
def test_a_table_of_slots_is_the_generated_one(marker, expected):
    pages.assert_generated(NAME, TEXT, marker, expected)


def test_the_page_of_slots_lists_all_arguments():
    listed = {option: repr(DEFAULTS.get(option)) for option in SLOTS_OPTIONS}
    pages.assert_arguments(TEXT, SlotsEnv, listed)


def test_gymnasium_finds_no_fault_in_slots_and_the_example_runs():
    check_env(gymnasium.make(NAME).unwrapped, skip_render_check=True)
    pages.run_example(TEXT)


@pytest.mark.parametrize(
    "order", ["carpark_papers, gymnasium", "gymnasium, carpark_papers"]
)
def test_the_id_is_registered_whichever_is_imported_first(order):
    code = f"import {order}; assert gymnasium.spec({NAME!r}).vector_entry_point"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

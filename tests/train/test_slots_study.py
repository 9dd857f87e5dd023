"""The experiments in slots: their data, their jobs and their verdicts."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from learners.sac.config import SACConfig
from studies import slots_jobs
from studies.slots import EXPERIMENTS, Claim, slots_experiment
from studies.slots_curves import draw_curves, write_curves
from studies.slots_jobs import Job, make_job, run_jobs
from studies.slots_report import KINDS, final_success, verdict, write_report


def test_the_twelve_are_there_and_all_can_be_trained():
    names = [experiment.name for experiment in EXPERIMENTS]
    assert names[:12] == [str(number) for number in range(1, 13)]
    assert len({*names}) == len(names)
    for experiment in EXPERIMENTS:
        config = SACConfig(phases=experiment.phases(1.0), replay=experiment.replay)
        assert {*config.kinds} <= {*KINDS}
        assert bool(experiment.claims) == experiment.name.isdigit()


def test_budgets_are_episodes_of_150_steps_times_the_scale():
    assert slots_experiment("10").phases(1.0) == ("slots:18750", "slots_diagonal:18750")
    assert slots_experiment("2").phases(0.1) == ("slots:1500",)


def test_experiments_that_train_alike_share_a_run(tmp_path):
    def folder(name, seed=0):
        return make_job(slots_experiment(name), "study", 1.0, seed, tmp_path).folder

    assert folder("2") == folder("4")
    assert folder("7") == folder("9")
    others = [folder(name) for name in ("2", "7", "10", "rehearsal-5", "clear")]
    assert len({*others, folder("2", seed=1)}) == 6


def test_every_run_has_a_log_of_its_own(tmp_path):
    jobs = {
        make_job(slots_experiment(name), "study", 1.0, seed, tmp_path)
        for name in ("10", "rehearsal-5", "rehearsal-20")
        for seed in (0, 1)
    }
    assert len({job.log for job in jobs}) == len(jobs) == 6


def test_a_job_begins_a_run_and_then_continues_it(tmp_path):
    job = make_job(slots_experiment("clear"), "study", 1.0, 3, tmp_path)
    begin = job.command(2.5)
    assert begin[-2:] == ["--time-limit", "2.50"]
    assert begin[begin.index("--seed") + 1] == "3"
    assert begin[begin.index("--at-switch") + 1] == "clear"
    assert "--resume" not in begin
    job.folder.mkdir()
    (job.folder / "config.json").touch()
    assert job.command(1.0)[2:] == [
        *("--resume", str(job.folder), "--time-limit", "1.00")
    ]


def scripted(folder: Path, code: str) -> Job:
    """A job that runs other code, and notes on which cores it may."""
    job = Job(folder, ())
    text = f"import os; print(os.sched_getaffinity(0)); {code}"
    object.__setattr__(job, "flags", (text,))
    return job


def test_jobs_run_on_a_core_each_and_failures_are_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        Job, "command", lambda self, minutes: [sys.executable, "-c", *self.flags]
    )
    good, bad = scripted(tmp_path / "good", ""), scripted(tmp_path / "bad", "exit(3)")
    assert run_jobs([good, bad], workers=1, minutes=0.0) == [bad]
    said = capsys.readouterr().out
    assert "good: stopped, to be continued" in said
    assert "bad: failed with exit code 3, see" in said
    cores = good.log.read_text()
    assert len(os.sched_getaffinity(0)) == 1 or "," not in cores


def test_no_job_begins_when_the_time_is_nearly_over(tmp_path):
    job = scripted(tmp_path / "late", "")
    assert run_jobs([job], workers=1, minutes=slots_jobs.LEAST / 2) == []
    assert not job.log.exists()


INTERRUPTED = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells may ignore it
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from studies.slots_jobs import Job, run_jobs
code = "import time; print(1, flush=True); time.sleep(0.5); print(2)"
Job.command = lambda self, minutes: [sys.executable, "-c", code]
run_jobs([Job(Path(sys.argv[1]) / name, ()) for name in "ab"], 1, 0.0)
"""


def test_an_interrupt_waits_for_the_job_and_begins_no_other(tmp_path):
    study = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, tmp_path, slots_jobs.SCRIPT.parent],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )
    log = tmp_path / "a.log"
    while not log.exists() or not log.read_text():
        time.sleep(0.02)
    study.send_signal(signal.SIGINT)
    _, error = study.communicate()
    assert error.endswith(b"KeyboardInterrupt\n")
    assert log.read_text() == "1\n2\n"
    assert not (tmp_path / "b.log").exists()


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

"""Runs side by side: cores, failures, time limits and interrupts."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.programs import exit_code

from carpark_papers import jobs
from carpark_papers.cederle.experiments import program as junction_study
from carpark_papers.jobs import Job, run_jobs
from carpark_papers.pandita.experiments import program as slots_study


def scripted(folder: Path, code: str) -> Job:
    """A job that runs other code, and notes on which cores it may."""
    job = Job("x", folder, ())
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
    assert run_jobs([job], workers=1, minutes=jobs.LEAST / 2) == []
    assert not job.log.exists()


INTERRUPTED = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells may ignore it
from pathlib import Path
from carpark_papers.jobs import Job, run_jobs
code = "import time; print(1, flush=True); time.sleep(0.5); print(2)"
Job.command = lambda self, minutes: [sys.executable, "-c", code]
run_jobs([Job("x", Path(sys.argv[1]) / name, ()) for name in "ab"], 1, 0.0)
"""


def test_an_interrupt_waits_for_the_job_and_begins_no_other(tmp_path):
    study = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, tmp_path],
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


STUDIES = pytest.mark.parametrize(
    ("script", "flags"),
    [(slots_study, ["--experiment", "2"]), (junction_study, ["--table", "6.1"])],
)


@STUDIES
@pytest.mark.parametrize(
    ("minutes", "code"), [("0.5", 2), ("1", 2), ("1.5", 0), ("0", 0)]
)
def test_a_time_in_which_no_run_begins_is_refused(
    script, flags, minutes, code, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(jobs, "run_jobs", lambda *arguments: [])
    flags = [*flags, "--runs-dir", str(tmp_path), "--minutes", minutes]
    assert exit_code(script, flags) == code
    said = re.search(rf"minutes must .*{float(minutes)}", capsys.readouterr().err)
    assert bool(said) == bool(code)


@STUDIES
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(
    script, flags, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(jobs, "run_jobs", lambda *arguments: pytest.fail("ran"))
    (tmp_path / "file").touch()
    assert (
        exit_code(script, [*flags, "--runs-dir", str(tmp_path / "file" / "runs")]) == 2
    )
    assert "cannot use" in capsys.readouterr().err

"""Sweeps: axes and groups; what is run by a stub, when, where, and what is written."""

import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import submitit
from helpers.programs import assert_refused, rows_of
from helpers.sweeping import plan_runs, train, train_badly, train_slowly
from submitit.core.submission import process_job
from submitit.helpers import DelayedSubmission
from submitit.slurm.test_slurm import mocked_slurm

from carpark_mj import sweeps
from carpark_mj.cli.settings.tables import Where
from carpark_mj.sweeps import (
    Work,
    locked,
    make_executor,
    open_sweep,
    read_outcome,
    run_sweep,
    submit_array,
    visible_gpus,
)
from carpark_mj.sweeps.plan import (
    Axis,
    Plan,
    checked_runs,
    groups,
    read_axis,
    runs,
    settings_of,
)
from carpark_mj.training.ppo.parts import PRESETS

HERE = Where(cluster="debug", side_by_side=1)
SUBMITIT_SIGNALS = signal.SIGTERM, signal.SIGCONT, signal.SIGUSR1, signal.SIGUSR2


@pytest.fixture(autouse=True)
def handlers() -> Iterator[None]:
    """Puts signals' handlers back: submitit's ignore SIGTERM, and it keeps them."""
    before = [(number, signal.getsignal(number)) for number in SUBMITIT_SIGNALS]
    yield
    for number, handler in before:
        signal.signal(number, handler)


def calls(folder: Path) -> list[str]:
    return (folder / "calls.txt").read_text().split()


def test_the_table_has_a_row_per_run(tmp_path):
    plan, runs = plan_runs("num_agents=1,2", "num_steps=100", repeats=2)
    assert run_sweep(tmp_path, plan, runs, HERE, train) == {"done": 4}
    rows = rows_of(tmp_path / "sweep.csv")
    assert [row["run"] for row in rows] == [run.name for run in runs]
    assert [row["env.num_agents"] for row in rows] == ["1", "1", "2", "2"]
    assert [row["seed"] for row in rows] == ["0", "1", "0", "1"]
    assert [row["length"] for row in rows] == ["10.0", "10.0", "20.0", "20.0"]
    for row in rows:
        assert row["status"] == "done"
        assert row["num_steps"] == "100"
        assert row["parked"] == "0.5"
        assert row["version_jax"]


def test_a_job_waits_for_one_that_a_killed_sweep_left(tmp_path):
    plan, (run,) = plan_runs("num_agents=1")
    open_sweep(tmp_path, plan, False)
    work = Work(tmp_path, (run,), train, own_process=False)
    with locked(tmp_path, run):
        job = threading.Thread(target=work)
        job.start()
        job.join(0.3)
        assert job.is_alive()
        assert not (tmp_path / "calls.txt").exists()
    job.join(30)
    assert calls(tmp_path) == [run.name]


def test_what_is_done_is_not_run_again_and_stays_in_the_table(tmp_path):
    for text, repeats in (("num_agents=1,2", 2), ("num_agents=2,3", 1)):
        plan, runs = plan_runs(text, repeats=repeats)
        for _ in range(2):
            run_sweep(tmp_path, plan, runs, HERE, train)
    rows = rows_of(tmp_path / "sweep.csv")
    assert sorted(calls(tmp_path)) == sorted(row["run"] for row in rows)
    ran = sorted((row["env.num_agents"], row["seed"], row["length"]) for row in rows)
    earlier = [("1", "10.0"), ("2", "20.0")]
    expected = [(count, seed, length) for count, length in earlier for seed in "01"]
    assert ran == [*expected, ("3", "0", "30.0")]
    assert {row["status"] for row in rows} == {"done"}


def test_failed_jobs_stop_no_others_and_are_tried_again(tmp_path, monkeypatch):
    # Submitit waits so long for the file of a killed process; this disk is not slow.
    monkeypatch.setattr(submitit.Job, "_results_timeout_s", 1)
    plan, runs = plan_runs("num_agents=1..4")
    where = Where(jobs=2)
    counts = run_sweep(tmp_path, plan, runs, where, train_badly)
    assert counts == {"done": 2, "failed": 2}
    one, two, three, four = rows_of(tmp_path / "sweep.csv")
    assert (one["status"], four["status"]) == ("done", "done")
    assert two["error"] == "two are a crowd"
    assert three["error"].startswith("its process ended: ")
    assert run_sweep(tmp_path, plan, runs, where, train_badly)["done"] == 3
    assert sorted(calls(tmp_path)) == [runs[0].name, runs[2].name, runs[3].name]


SWEEP = """
import sys
from pathlib import Path
from helpers.sweeping import plan_runs, train_slowly
from carpark_mj.sweeps import run_sweep
from carpark_mj.cli.settings.tables import Where
plan, runs = plan_runs("num_agents=1..3")
where = Where(cluster="debug", side_by_side=1)
run_sweep(Path(sys.argv[1]), plan, runs, where, train_slowly)
"""


def test_a_killed_sweep_goes_on_where_it_was(tmp_path):
    paths = os.pathsep.join([*sys.path, str(Path(__file__).parents[1])])
    process = subprocess.Popen(
        [sys.executable, "-c", SWEEP, str(tmp_path)],
        env=os.environ | {"PYTHONPATH": paths},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    plan, runs = plan_runs("num_agents=1..3")
    steps = [tmp_path / "runs" / run.name / "steps.txt" for run in runs]
    while process.poll() is None and not steps[1].exists():
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not steps[2].exists()  # it was killed in the middle of the second
    statuses = [read_outcome(tmp_path, run).status for run in runs[:2]]
    assert statuses == ["done", "waiting"]
    kept = steps[1].read_text()
    assert run_sweep(tmp_path, plan, runs, HERE, train_slowly) == {"done": 3}
    assert calls(tmp_path) == [run.name for run in runs]  # each once
    assert [path.read_text() for path in steps] == ["0123456789"] * 3
    assert "0123456789".startswith(kept)


def test_a_group_s_failure_leaves_the_runs_that_were_done(tmp_path):
    plan, runs = plan_runs("num_agents=1..2")
    open_sweep(tmp_path, plan, False)
    Work(tmp_path, tuple(runs), train_badly, own_process=False)()
    assert [read_outcome(tmp_path, run).status for run in runs] == ["done", "failed"]


def slurm_jobs(folder: Path, repeats=2) -> list[tuple[Work, submitit.Job]]:
    """Jobs of two runs and what Slurm is asked for."""
    plan, runs = plan_runs("num_agents=1", repeats=repeats)
    open_sweep(folder, plan, False)
    asked = ("partition=gpu", "qos=long", "constraint=h200", "time=90", "mem_gb=8")
    asked += ("gpus-per-node=2", "cpus-per-task=6")
    where = Where(cluster="slurm", jobs=1, slurm=asked)
    works = [Work(folder, (run,), train, own_process=False) for run in runs]
    return submit_array(make_executor(where, folder / "logs"), works)


def test_a_submission_to_slurm_asks_for_its_settings(tmp_path):
    flags = ("partition=gpu", "qos=long", "constraint=h200", "time=90", "mem=8GB")
    flags += ("gpus-per-node=2", "cpus-per-task=6", f"job-name={tmp_path.name}")
    with mocked_slurm() as mocked:
        jobs = slurm_jobs(tmp_path)
        [script] = (tmp_path / "logs").glob("*_submission.sh")
        lines = script.read_text().splitlines()
        for flag in (*flags, "array=0-1%1"):
            assert f"#SBATCH --{flag}" in lines
        assert not any("account" in line for line in lines)
        for _, job in jobs:
            delayed = DelayedSubmission.load(job.paths.submitted_pickle)
            assert delayed._timeout_countdown == sweeps.REQUEUES
            with mocked.job_context(job.job_id):
                process_job(job.paths.folder)
        for work, _ in jobs:
            assert read_outcome(tmp_path, work.runs[0]).status == "done"
        other = ("timeout_min=30", "mem_gb=1.5", 'setup=["module load cuda"]')
        asked = make_executor(Where(cluster="slurm", slurm=other), tmp_path)
        found = asked._executor.parameters
        assert (found["time"], found["mem"]) == (30, "1536MB")
        assert found["setup"] == ["module load cuda"]
        for wrong in ("gpu=1", "setup=module load cuda"):
            with pytest.raises(ValueError, match="cluster slurm: "):
                make_executor(Where(cluster="slurm", slurm=(wrong,)), tmp_path)


@pytest.mark.parametrize(
    ("cluster", "setting"), [("slurm", "partition"), ("local", "partition=gpu")]
)
def test_settings_of_slurm_have_values_and_a_cluster(cluster, setting):
    with pytest.raises(ValueError, match=setting):
        Where(cluster=cluster, slurm=(setting,))


def test_jobs_that_stand_in_the_queue_are_not_submitted_again(tmp_path, monkeypatch):
    with mocked_slurm():
        ids = [job.job_id for _, job in slurm_jobs(tmp_path)]
        answers = iter([None, {ids[0], "999"}])  # at first Slurm is too busy
        monkeypatch.setattr(sweeps, "queued_jobs", lambda: next(answers))
        monkeypatch.setitem(sweeps.POLL_SECONDS, "slurm", 0.0)
        again = slurm_jobs(tmp_path, repeats=3)
    assert again[0][1].job_id == ids[0]
    assert [len(work.runs) for work, _ in again] == [1, 1, 1]
    names = [work.runs[0].name for work, _ in again]
    assert sorted(names) == ["seed=0", "seed=1", "seed=2"]
    assert not {job.job_id for _, job in again[1:]} & {*ids}
    known = json.loads((tmp_path / "logs" / "jobs.json").read_text())
    assert sorted(known) == sorted(names)


@pytest.mark.parametrize(("visible", "shared"), [("0,1", "01"), ("3", "33")])
def test_local_jobs_share_the_gpus(visible, shared, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", visible)
    assert [visible_gpus(slot, 2) for slot in range(2)] == [(x,) for x in shared]
    assert visible_gpus(0, 1) == tuple(visible.split(","))  # alone it has all


def test_a_job_sees_the_gpus_it_was_given(tmp_path, monkeypatch):
    plan, runs = plan_runs()
    open_sweep(tmp_path, plan, False)
    seen = []

    def look(runs, sweep, stochastic, tell):
        seen.append(os.environ.get("CUDA_VISIBLE_DEVICES"))

    work = Work(tmp_path, tuple(runs), look, own_process=False)
    for gpus in (("1",), (), None):
        monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")  # as submitit leaves it
        dataclasses.replace(work, gpus=gpus)()
    assert seen == ["1", None, ""]


def test_a_job_that_leaves_the_queue_without_a_result_has_failed(tmp_path, monkeypatch):
    plan, runs = plan_runs("num_agents=1,2")
    answers = iter([{"12_0", "12_1"}, {"12_0", "12_1"}, {"12_1"}, set()])
    monkeypatch.setattr(sweeps, "queued_jobs", lambda: next(answers))
    monkeypatch.setitem(sweeps.POLL_SECONDS, "slurm", 0.0)
    where = Where(cluster="slurm", side_by_side=1)
    with mocked_slurm():
        counts = run_sweep(tmp_path, plan, runs, where, train)
    assert counts == {"failed": 2}
    [row, _] = rows_of(tmp_path / "sweep.csv")
    assert "left the queue without a result" in row["error"]


def axes(*texts, base="square"):
    return tuple(read_axis(text, PRESETS[base]) for text in texts)


@pytest.mark.parametrize(
    ("text", "field", "values"),
    [
        ("env.num_agents=1,5..6", "env.num_agents", ["1", "5", "6"]),
        ("num-lots=-1..0", "num_lots", ["-1", "0"]),
        ("discount=0.99, 0.995", "discount", ["0.99", "0.995"]),
        ("layout=../a.json", "env.layout", ["../a.json"]),
        ("scheme=L,L,S;G,G,A", "env.giving_way.scheme", ["L,L,S", "G,G,A"]),
    ],
)
def test_an_axis_is_a_field_and_its_values(text, field, values):
    axis = read_axis(text, PRESETS["dynamic"])
    assert axis == Axis((field,), tuple((value,) for value in values))


def test_every_combination_has_every_seed_and_its_own_folder():
    plan = Plan("square", axes("num_agents=1..3", "clip=0.1,0.2"), 2, seed=5)
    found = checked_runs(plan)
    assert len(plan) == len(found) == 3 * 2 * 2
    configs = [settings_of(run) for run in found]
    assert {(c.env.num_agents, c.clip, c.seed) for c in configs} == {
        (n, clip, seed) for n in (1, 2, 3) for clip in (0.1, 0.2) for seed in (5, 6)
    }
    assert len({run.name for run in found}) == len(found)
    assert found[0].name == "num_agents=1,clip=0.1,seed=5"


def test_settings_of_one_value_are_unnamed_and_videos_not_made():
    [run] = checked_runs(Plan("square", axes("num_agents=2", "closeness=1")))
    config = settings_of(run)
    assert (run.name, config.env.num_agents, config.video_seconds) == ("seed=0", 2, 0)
    assert config.env.reward.closeness == 1.0
    [other] = runs(Plan("cpu", axes("video_seconds=3")))
    assert settings_of(other).video_seconds == 3


def test_settings_can_change_together():
    fields = ("env.giving_way.scheme", "env.observation.global_information")
    axis = Axis(fields, (("L,L,S", "false"), ("G,G,A", "true")))
    first, second = checked_runs(Plan("dynamic", (axis,)))
    assert not settings_of(first).env.observation.global_information
    assert settings_of(second).env.giving_way.scheme == "G,G,A"


def test_groups_differ_in_seeds_and_data_only():
    swept = axes("num_agents=1,2", "discount=0.9,0.95,0.99")
    found = groups(checked_runs(Plan("square", swept, repeats=2)), 4)
    assert sorted(map(len, found)) == [2, 2, 4, 4]
    for group in found:
        assert len({settings_of(run).env.num_agents for run in group}) == 1
    alone = groups(checked_runs(Plan("cpu", (), repeats=3)), 8)  # end by the clock
    assert list(map(len, alone)) == [1, 1, 1]


BAD = [
    ("--set num_agent=1", "unknown setting 'num_agent'"),
    ("--set tyres", "FIELD=VALUES"),
    ("--set num_agents=1,1", "env.num_agents has no values, or one twice"),
    ("--set clip=0.1,0.10", "clip=0.10: the same settings as clip=0.1"),
    ("--set clip=0.1 clip=0.2", "clip is given twice"),
    ("--set num_agents=2,21", "num_agents=21: num_parked_cars"),
    ("--set discount=0.9,1.5", "discount=1.5: discount must lie in [0, 1]"),
    ("--set clip=-h,0.2", "clip takes values, not flags"),
    ("--set seed=1..3", "seed is not swept"),
    ("--name a/b", "name must be the name of one folder"),
]


@pytest.mark.parametrize(("flags", "said"), BAD)
def test_a_bad_sweep_is_one_sentence_before_anything_runs(
    flags, said, capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sweeps, "run_sweep", pytest.fail)
    assert_refused(capsys, "sweep", ["--base", "cpu", *flags.split()], said)
    assert list(tmp_path.iterdir()) == []

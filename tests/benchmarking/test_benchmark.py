"""The benchmark: what it asks, how it compares; rates themselves are the machine's."""

import contextlib
import csv
import dataclasses
import json
import subprocess
from pathlib import Path
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
from helpers.programs import exit_code

import carpark_mj
from carpark_mj.benchmarking import checkouts, report, run, worker
from carpark_mj.benchmarking.checkouts import Checkout
from carpark_mj.benchmarking.records import Job, Measurement
from carpark_mj.benchmarking.report import Row
from carpark_mj.programs import benchmark
from carpark_mj.training.ppo import learner
from carpark_mj.training.ppo.parts import PRESETS

# Where the tests' own carpark_mj lies: installed, or in the checkout.
IMPORTED = Path(str(carpark_mj.__file__)).parents[1]
OURS = Checkout("here", Path("ours"), "1234567")
THEIRS = Checkout("main~1", Path("theirs"), "89abcde")
JOB = Job("physics", "brush", 3, 2, 16, steps=2, timings=1, clock="wall")


def measured(rate, compile_s=10.0):
    return Measurement(
        device="2 CPU cores",
        jax="0.10.2",
        mujoco="4.0.0",
        what="env",
        layout="square",
        agents=2,
        lots=128,
        rate=rate,
        unit="agent-steps/s",
        compile_s=compile_s,
        first_step_s=2 * compile_s,
        peak_memory_mb=1000.0,
    )


def rows(checkout, *measurements):
    return [Row(JOB, checkout, i, m) for i, m in enumerate(measurements, start=1)]


def test_the_best_rounds_are_compared_and_the_range_is_that_of_the_rounds():
    ours = rows(OURS, measured(90.0, 10.0), measured(110.0, 8.0))
    theirs = rows(THEIRS, measured(100.0, 16.0), measured(88.0, 10.0))
    # Rates: 110 / 100; in the rounds 90 / 100 and 110 / 88.
    assert report.ratio(ours, theirs, "rate") == report.Ratio(1.1, 0.9, 1.25)
    # Seconds, of which the least is best: 8 / 10; in the rounds 10 / 16 and 8 / 10.
    assert report.ratio(ours, theirs, "compile_s") == report.Ratio(0.8, 0.625, 0.8)


def test_the_table_has_a_line_for_each_checkout_and_one_of_their_ratios():
    ours = rows(OURS, measured(9000.0), measured(11000.0, 8.0))
    theirs = rows(THEIRS, measured(10000.0), measured(10000.0))
    lines = report.markdown([*ours, *theirs]).splitlines()
    assert lines[0] == "2 CPU cores, JAX 0.10.2, MuJoCo 4.0.0"
    assert len({line.count("|") for line in lines[2:]}) == 1
    cells = [[c.strip() for c in line.strip("|").split("|")] for line in lines[4:]]
    about = ["env", "square", "2", "128"]
    unit = "agent-steps/s"
    assert cells == [
        [*about, "here (1234567)", "11,000", unit, "8.0", "16.0", "1,000.0"],
        [*about, "main~1 (89abcde)", "10,000", unit, "10.0", "20.0", "1,000.0"],
        [
            *about,
            "ratio",
            "1.100 (0.900 … 1.100)",
            "",
            "0.800 (0.800 … 1.000)",
            "0.800 (0.800 … 1.000)",
            "1.000 (1.000 … 1.000)",
        ],
    ]


def test_one_checkout_alone_has_no_ratio():
    assert len(report.table_rows(rows(OURS, measured(1.0), measured(2.0)))) == 1


def test_checkouts_take_turns_and_an_interrupted_run_keeps_its_rows(
    monkeypatch, tmp_path
):
    asked = []

    def run_job(job, checkout):
        if len(asked) == 6:
            raise KeyboardInterrupt
        asked.append((job.lots, checkout.name))
        return dataclasses.replace(measured(1.0), lots=job.lots)

    monkeypatch.setattr(run, "run_job", run_job)
    out = tmp_path / "benchmark.csv"
    jobs = [dataclasses.replace(JOB, lots=lots) for lots in (4, 8)]
    with pytest.raises(KeyboardInterrupt):
        run.measure(jobs, [OURS, THEIRS], repeats=3, out=str(out))
    turns = [(4, "here"), (4, "main~1"), (8, "here"), (8, "main~1")]
    assert asked == turns + turns[:2]
    with out.open(newline="") as file:
        kept = list(csv.DictReader(file))
    assert [(int(row["lots"]), row["checkout"]) for row in kept] == asked
    assert [row["round"] for row in kept] == ["1"] * 4 + ["2"] * 2
    assert kept[1]["commit"] == "89abcde"
    assert kept[1]["unit"] == "agent-steps/s"


def test_each_round_measures_every_variant_in_every_batch():
    config = benchmark.BenchmarkConfig(batches=(4, 8), layouts=("square", "mixture"))
    asked = [(job.what, job.variant, job.lots) for job in config.jobs()]
    variants = [
        ("env", "square"),
        ("env", "mixture"),
        ("ppo", "auto"),
        ("physics", "brush"),
        ("physics", "mjx.step"),
        ("physics", "contact"),
    ]
    assert asked == [(*variant, lots) for variant in variants for lots in (4, 8)]


def test_only_env_has_several_numbers_of_agents():
    config = benchmark.BenchmarkConfig(cars=("brush",), num_agents=(1, 4))
    asked = [(job.what, job.num_agents) for job in config.jobs()]
    assert asked == [("env", 1), ("env", 4), ("ppo", 1), ("physics", 1)]


def test_only_ppo_has_several_runs_side_by_side():
    config = benchmark.BenchmarkConfig(cars=("brush",), runs=(1, 4))
    asked = [(job.what, job.runs) for job in config.jobs()]
    assert asked == [("env", 1), ("ppo", 1), ("ppo", 4), ("physics", 1)]


@pytest.mark.parametrize(
    "change",
    [
        {"steps": 0},
        {"timings": 0},
        {"repeats": 0},
        {"num_agents": (0,)},
        {"num_agents": ()},
        {"batches": ()},
        {"batches": (8, 0)},
        {"runs": (1, 0)},
        {"what": ()},
        {"layouts": ()},
    ],
)
def test_impossible_settings_are_refused(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must "):
        benchmark.BenchmarkConfig(**change)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--batch", "4"], "Unrecognized options: --batch, 4"),
        (["--batches", "0"], "batches must be at least 1, not 0"),
        (["--steps", "many"], "many"),
        (["--against", "no-such-commit"], "not 'no-such-commit'"),
        (["--against=--help"], "not '--help'"),
        (["--against", "FOLDER"], "must hold carpark_mj"),
        (["--out", "FOLDER/missing/benchmark.csv"], "cannot use"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(flags, said, tmp_path, capsys):
    flags = [flag.replace("FOLDER", str(tmp_path)) for flag in flags]
    assert exit_code(benchmark, flags) == 2
    error = capsys.readouterr().err
    assert error.startswith("program: ")
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.skipif(
    not (checkouts.ROOT / ".git").exists(), reason="not a clone of the repository"
)
def test_a_commit_is_checked_out_for_the_while_and_no_trace_of_it_stays():
    def worktrees():
        return checkouts.git(checkouts.ROOT, "worktree", "list")

    before = worktrees()
    with contextlib.suppress(KeyError), checkouts.other_checkout("HEAD") as other:
        assert (other.path / "carpark_mj" / "__init__.py").is_file()
        assert checkouts.commit_of(other.path) == other.commit
        assert worktrees() != before
        raise KeyError
    assert not other.path.exists()
    assert worktrees() == before


def test_a_job_is_measured_in_a_process_of_its_own_without_compiled_programs(
    monkeypatch,
):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/nonexistent")
    result = run.run_job(JOB, checkouts.here())
    assert result.what == "physics brush 10 ms"
    assert result.unit == "car-substeps/s"
    assert result.lots == 3
    assert result.rate > 0
    assert 0 < result.compile_s < result.first_step_s
    assert result.peak_memory_mb > 10
    environment = run.worker_environment(Path("other"))
    assert "JAX_COMPILATION_CACHE_DIR" not in environment
    assert environment["PYTHONPATH"].split(":")[0] == "other"


def test_what_a_checkout_refuses_is_said_in_its_words(monkeypatch, capsys):
    job = dataclasses.replace(JOB, what="env", variant="nowhere")
    request = {"job": vars(job), "checkout": str(IMPORTED), "started": 0.0}
    assert worker.main(json.dumps(request)) == 2
    said = capsys.readouterr().err
    assert said.startswith("unknown layout 'nowhere'; choose from")

    def refused(command, **_):
        return subprocess.CompletedProcess(command, 2, "", f"a warning\n{said}")

    monkeypatch.setattr(subprocess, "run", refused)
    with pytest.raises(ValueError, match=r"^unknown layout 'nowhere'; choose from"):
        run.run_job(job, checkouts.here())


@pytest.mark.parametrize(
    ("code", "stderr", "said"),
    [
        (1, "Traceback ...\nRESOURCE_EXHAUSTED: 3 TB\n", "RESOURCE_EXHAUSTED: 3 TB$"),
        (-9, "", "killed by signal 9"),
    ],
)
def test_a_process_that_fails_is_named_in_one_line(monkeypatch, code, stderr, said):
    def failed(command, **_):
        return subprocess.CompletedProcess(command, code, "", stderr)

    monkeypatch.setattr(subprocess, "run", failed)
    with pytest.raises(run.WorkerError, match=f"physics brush with 3 lots.*{said}"):
        run.run_job(JOB, checkouts.here())


def test_only_the_checkout_that_was_asked_for_is_measured(tmp_path):
    worker.require_checkout(IMPORTED)
    with pytest.raises(ValueError, match="not the carpark_mj of"):
        worker.require_checkout(tmp_path)


@pytest.mark.parametrize(
    ("tyres", "ms", "substeps"),
    [("brush", 10, 20), ("mjx.step", 10, 20), ("contact", 4, 50)],
)
def test_each_tyre_model_runs_at_the_substep_of_its_physics_report(tyres, ms, substeps):
    subject = worker.physics_subject(dataclasses.replace(JOB, variant=tyres))
    assert subject.what == f"physics {tyres} {ms} ms"
    assert subject.count == 3 * 2 * substeps  # cars, control steps of 0.2 s


def test_the_steps_of_a_training_are_those_of_present_agents(monkeypatch):
    class Learner:
        def __init__(self, config):
            self.config = config

        def compile(self):
            return None

        def init(self):
            present = jnp.ones(4 * self.config.env.num_agents).at[5:].set(0.0)
            return SimpleNamespace(env=SimpleNamespace(info={"present": present}))

    monkeypatch.setattr(learner, "Learner", Learner)
    monkeypatch.setattr(worker, "configure_jax", lambda: None)  # it is running
    subject = worker.ppo_subject(dataclasses.replace(JOB, variant="anywhere", lots=4))
    assert subject.count == 5 * PRESETS["anywhere"].unroll_length


def test_a_gpu_has_its_own_name_and_its_own_memory(monkeypatch):
    class Device:
        platform, device_kind = "gpu", "NVIDIA H100 80GB HBM3"

        def memory_stats(self):
            return {"peak_bytes_in_use": 123}

    monkeypatch.setattr(jax, "devices", lambda: [Device()])
    assert worker.device_name() == "NVIDIA H100 80GB HBM3"
    assert worker.peak_memory() == 123


def test_a_measurement_that_fails_says_last_why_not_what_jax_notes(capsys, monkeypatch):
    error = RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nallocating 9 GB")
    error.add_note("--------------------\nJAX has removed its internal frames.")

    def fail(*_):
        raise error

    monkeypatch.setattr(worker, "measure", fail)
    request = {
        "job": dataclasses.asdict(JOB),
        "checkout": str(IMPORTED),
        "started": 0.0,
    }
    assert worker.main(json.dumps(request)) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "RuntimeError: RESOURCE_EXHAUSTED: Out of memory"

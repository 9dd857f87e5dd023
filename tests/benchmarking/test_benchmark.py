"""The benchmark: what it asks, how it compares; rates themselves are the machine's."""

import csv
import dataclasses
import json
import subprocess
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
from helpers.programs import assert_refused

from carpark_mj import benchmarking
from carpark_mj.benchmarking import BenchmarkConfig, Job, Measurement, jobs_of
from carpark_mj.benchmarking.start import Start, count_equations, rows
from carpark_mj.training.ppo import learner
from carpark_mj.training.ppo.parts import PRESETS

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


def test_the_table_has_the_best_round_of_each_job():
    rounds = {JOB: [measured(9000.0), measured(11000.0, 8.0)]}
    lines = benchmarking.markdown(rounds).splitlines()
    assert lines[0] == "2 CPU cores, JAX 0.10.2, MuJoCo 4.0.0"
    assert len({line.count("|") for line in lines[2:]}) == 1
    [cells] = [[c.strip() for c in line.strip("|").split("|")] for line in lines[4:]]
    about = ["env", "square", "2", "128", "11,000", "agent-steps/s"]
    assert cells == [*about, "8.0", "16.0", "1,000.0"]


def test_jobs_take_turns_and_an_interrupted_run_keeps_its_rows(monkeypatch, tmp_path):
    asked = []

    def run_job(job):
        if len(asked) == 3:
            raise KeyboardInterrupt
        asked.append(job.lots)
        return dataclasses.replace(measured(1.0), lots=job.lots)

    monkeypatch.setattr(benchmarking, "run_job", run_job)
    out = tmp_path / "benchmark.csv"
    jobs = [dataclasses.replace(JOB, lots=lots) for lots in (4, 8)]
    with pytest.raises(KeyboardInterrupt):
        benchmarking.measure(jobs, repeats=3, out=str(out))
    assert asked == [4, 8, 4]
    with out.open(newline="") as file:
        kept = [(int(row["lots"]), row["round"]) for row in csv.DictReader(file)]
    assert kept == [(4, "1"), (4, "2"), (8, "1")]


def asked(**settings):
    return jobs_of(BenchmarkConfig(**settings))


def test_each_round_measures_every_variant_in_every_batch():
    found = asked(batches=(4, 8), layouts=("square", "mixture"))
    variants = [("env", "square"), ("env", "mixture"), ("ppo", "auto")]
    variants += [("physics", tyres) for tyres in ("brush", "mjx.step", "contact")]
    assert [(job.what, job.variant, job.lots) for job in found] == [
        (*variant, lots) for variant in variants for lots in (4, 8)
    ]
    # Only env has several numbers of agents, and only ppo several runs side by side.
    agents = [(x.what, x.num_agents) for x in asked(cars=("brush",), num_agents=(1, 4))]
    assert agents == [("env", 1), ("env", 4), ("ppo", 1), ("physics", 1)]
    runs = [(job.what, job.runs) for job in asked(cars=("brush",), runs=(1, 4))]
    assert runs == [("env", 1), ("ppo", 1), ("ppo", 4), ("physics", 1)]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--batch 4", "Unrecognized options: --batch, 4"),
        ("--batches 0", "batches must be at least 1, not (0,)"),
        ("--steps many", "many"),
        ("--out FOLDER/missing/benchmark.csv", "cannot use"),
        ("--what start --environments nowhere", "nowhere"),
        ("--what start env", "start"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(flags, said, tmp_path, capsys):
    words = flags.replace("FOLDER", str(tmp_path)).split()
    assert_refused(capsys, "benchmark", words, said)


@pytest.mark.slow
def test_a_job_is_measured_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/nonexistent")
    result = benchmarking.run_job(JOB)
    assert result.what == "physics brush 10 ms"
    assert result.unit == "car-substeps/s"
    assert result.lots == 3
    assert result.rate > 0
    assert 0 < result.compile_s < result.first_step_s
    assert result.peak_memory_mb > 10


def test_refusals_of_the_worker_are_passed_on(monkeypatch, capsys):
    job = dataclasses.replace(JOB, what="env", variant="nowhere")
    request = {"job": vars(job), "started": 0.0}
    assert benchmarking.work(json.dumps(request)) == 2
    said = capsys.readouterr().err
    assert said.startswith("unknown layout 'nowhere'; choose from")

    def refused(command, **_):
        return subprocess.CompletedProcess(command, 2, "", f"a warning\n{said}")

    monkeypatch.setattr(subprocess, "run", refused)
    with pytest.raises(ValueError, match=r"^unknown layout 'nowhere'; choose from"):
        benchmarking.run_job(job)


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
    with pytest.raises(
        benchmarking.WorkerError, match=f"physics brush with 3 lots.*{said}"
    ):
        benchmarking.run_job(JOB)


@pytest.mark.parametrize(
    ("tyres", "ms", "substeps"),
    [("brush", 10, 20), ("mjx.step", 10, 20), ("contact", 4, 50)],
)
def test_each_tyre_model_runs_at_its_own_substep(tyres, ms, substeps):
    subject = benchmarking.physics_subject(dataclasses.replace(JOB, variant=tyres))
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
    monkeypatch.setattr(benchmarking, "configure_jax", lambda: None)  # it is running
    subject = benchmarking.ppo_subject(
        dataclasses.replace(JOB, variant="anywhere", lots=4)
    )
    assert subject.count == 5 * PRESETS["anywhere"].unroll_length


def test_a_gpu_has_its_own_name_and_its_own_memory(monkeypatch):
    class Device:
        platform, device_kind = "gpu", "NVIDIA H100 80GB HBM3"

        def memory_stats(self):
            return {"peak_bytes_in_use": 123}

    monkeypatch.setattr(jax, "devices", lambda: [Device()])
    assert benchmarking.device_name() == "NVIDIA H100 80GB HBM3"
    assert benchmarking.peak_memory() == 123


def test_a_measurement_that_fails_says_last_why(capsys, monkeypatch):
    error = RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nallocating 9 GB")
    error.add_note("--------------------\nJAX has removed its internal frames.")

    def fail(*_):
        raise error

    monkeypatch.setattr(benchmarking, "measure_job", fail)
    request = {"job": dataclasses.asdict(JOB), "started": 0.0}
    assert benchmarking.work(json.dumps(request)) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "RuntimeError: RESOURCE_EXHAUSTED: Out of memory"


ONE = Start(
    environment="default",
    lots=1,
    process="first",
    device="cpu",
    import_s=1.0,
    construct_s=0.5,
    reset_s=4.0,
    step_s=6.0,
    total_s=11.5,
    reset_equations=2000,
    step_equations=6000,
)


def test_loops_and_calls_count_what_they_hold():
    def loop(x):
        return jax.lax.fori_loop(0, 9, lambda _, y: jnp.sin(y) + 1.0, x)

    flat = jax.make_jaxpr(lambda x: jnp.sin(x) + 1.0)(0.0)
    assert count_equations(flat.jaxpr) == 2
    called = jax.make_jaxpr(jax.jit(lambda x: jnp.sin(x) + 1.0))(0.0)
    assert count_equations(called.jaxpr) == 2
    looped = count_equations(jax.make_jaxpr(loop)(0.0).jaxpr)
    assert 3 <= looped < 9


def test_rows_are_medians_of_both_processes():
    times = 9.0, 10.0, 30.0
    found = [dataclasses.replace(ONE, total_s=x) for x in times]
    found += [dataclasses.replace(x, process="second", total_s=2.0) for x in found]
    [row] = rows(found)
    assert row["environment"] == "default"
    assert row["first: total [s]"] == "10.0"
    assert row["second: total [s]"] == "2.0"
    assert row["step equations"] == "6,000"

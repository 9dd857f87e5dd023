"""The benchmark: what it asks, how it compares; rates themselves are the machine's."""

import dataclasses
import subprocess
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
from helpers.programs import assert_refused, rows_of

from carpark_mj import benchmarking
from carpark_mj.benchmarking import BenchmarkConfig, Job, count_equations, jobs_of
from carpark_mj.training.ppo import group
from carpark_mj.training.ppo.parts import PRESETS

JOB = Job("physics", "brush", 3, 2, 16, steps=2, timings=1, clock="wall")


def measured(rate, compile_s=10.0):
    about = {"device": "2 CPU cores", "jax": "0.10.2", "mujoco": "4.0.0"}
    about |= {"what": "env", "layout": "square", "agents": 2, "lots": 128}
    found = {"rate": rate, "unit": "agent-steps/s", "compile_s": compile_s}
    return about | found | {"peak_memory_mb": 1000.0}


def test_the_table_has_the_best_round_of_each_job():
    rounds = {JOB: [measured(9000.0), measured(11000.0, 8.0)]}
    lines = benchmarking.table(rounds).splitlines()
    assert lines[0] == "2 CPU cores, JAX 0.10.2, MuJoCo 4.0.0"
    assert len({line.count("|") for line in lines[2:]}) == 1
    [cells] = [[c.strip() for c in line.strip("|").split("|")] for line in lines[4:]]
    about = ["env", "square", "2", "128", "11,000", "agent-steps/s"]
    assert cells == [*about, "8.0", "1,000.0"]


def test_jobs_take_turns_and_an_interrupted_run_keeps_its_rows(tmp_path):
    asked = []

    def run_job(job):
        if len(asked) == 3:
            raise KeyboardInterrupt
        asked.append(job.lots)
        return [measured(1.0) | {"lots": job.lots}]

    out = tmp_path / "benchmark.csv"
    jobs = [dataclasses.replace(JOB, lots=lots) for lots in (4, 8)]
    with pytest.raises(KeyboardInterrupt):
        benchmarking.measure(jobs, run_job, repeats=3, out=str(out))
    assert asked == [4, 8, 4]
    kept = [(int(row["lots"]), row["round"]) for row in rows_of(out)]
    assert kept == [(4, "1"), (8, "1"), (4, "2")]


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
    starts = [
        (x.variant, x.lots) for x in asked(what=("start",), environments=("first",))
    ]
    assert starts == [("first", 128)]
    runs = [(job.what, job.runs) for job in asked(cars=("brush",), runs=(1, 4))]
    assert runs == [("env", 1), ("ppo", 1), ("ppo", 4), ("physics", 1)]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("--out FOLDER/missing/benchmark.csv", "cannot use"),
        ("--what start --environments default nowhere", "nowhere"),
        ("--what start env", "start"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(flags, said, tmp_path, capsys):
    words = flags.replace("FOLDER", str(tmp_path)).split()
    assert_refused(capsys, "benchmark", words, said)


@pytest.mark.slow
def test_a_job_is_measured_in_a_process_of_its_own(monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", "/nonexistent")
    [result] = benchmarking.run_job(JOB)
    assert result["what"] == "physics brush 10 ms"
    assert result["unit"] == "car-substeps/s"
    assert result["lots"] == 3
    assert result["rate"] > 0
    assert result["compile_s"] > 0
    assert result["peak_memory_mb"] > 10


FAILED = "could not measure physics brush with 3 lots: "
OOM = "RESOURCE_EXHAUSTED: 3 TB"


@pytest.mark.parametrize(
    ("code", "stderr", "error", "said"),
    [
        (1, f"Traceback ...\n{OOM}\n", benchmarking.WorkerError, f"{FAILED}{OOM}$"),
        (-9, "", benchmarking.WorkerError, f"{FAILED}killed by signal 9"),
        (2, "a warning\nunknown layout", ValueError, "^unknown layout"),
    ],
)
def test_a_process_that_fails_is_named_in_one_line(
    monkeypatch, code, stderr, error, said
):
    failed = subprocess.CompletedProcess([], code, "", stderr)
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(error, match=said):
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

    monkeypatch.setattr(group, "Learner", Learner)
    monkeypatch.setattr(benchmarking, "configure_jax", lambda: None)  # it is running
    subject = benchmarking.ppo_subject(
        dataclasses.replace(JOB, variant="anywhere", lots=4)
    )
    assert subject.count == 5 * PRESETS["anywhere"].unroll_length


def test_loops_and_calls_count_what_they_hold():
    def loop(x):
        return jax.lax.fori_loop(0, 9, lambda _, y: jnp.sin(y) + 1.0, x)

    flat = jax.make_jaxpr(lambda x: jnp.sin(x) + 1.0)(0.0)
    assert count_equations(flat.jaxpr) == 2
    called = jax.make_jaxpr(jax.jit(lambda x: jnp.sin(x) + 1.0))(0.0)
    assert count_equations(called.jaxpr) == 2
    looped = count_equations(jax.make_jaxpr(loop)(0.0).jaxpr)
    assert 3 <= looped < 9

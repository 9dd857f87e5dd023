"""`carpark_mj benchmark`: speed, compilation, memory, and the time to a first step.

Every job is measured in a process of its own, by `work`. Results are dictionaries, the
rows of the CSV file.
"""

import dataclasses
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from carpark_mj.cli.process import OUTPUT_FUSION, configure_jax, enable_output_fusion
from carpark_mj.cli.settings.tables import BenchmarkConfig, Clock, What
from carpark_mj.compilation import compile_for_one_lot
from carpark_mj.config import CONTACT_SIM_DT, EnvConfig, SimConfig
from carpark_mj.evaluation import tables
from carpark_mj.files import write_csv
from carpark_mj.registry import environment

# What is called a second: of the wall clock, or of all threads of this process, which
# other work on the machine disturbs far less.
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
# Seconds that a process reports of a start, in the order in which it spends them.
PHASES = ("import_s", "construct_s", "reset_s", "step_s", "total_s")
WORKER = (
    "import sys; from carpark_mj.benchmarking import work; sys.exit(work(sys.argv[1]))"
)

Result = dict[str, Any]


class WorkerError(Exception):
    """A measurement failed, possibly out of memory."""


@dataclasses.dataclass(frozen=True)
class Job:
    """The measurement of one process, of `start` of two; see `BenchmarkConfig`."""

    what: What
    # layout of `env`, preset of `ppo`, tyres or stepper of `physics`, environment of
    # `start`
    variant: str
    lots: int  # simulated at once; for `physics`, cars
    num_agents: int  # in each lot of `env`; others have their own
    num_parked_cars: int  # in each lot of `env`
    steps: int
    timings: int
    clock: Clock
    runs: int = 1


def jobs_of(config: BenchmarkConfig) -> list[Job]:
    """What each round measures; `ValueError` of an unknown environment."""
    variants = {
        "env": config.layouts,
        "ppo": (config.preset,),
        "physics": config.cars,
        "start": config.environments,
    }
    for name in config.environments if "start" in config.what else ():
        _environment(name)
    same = config.num_parked_cars, config.steps, config.timings, config.clock
    return [
        Job(what, variant, lots, agents, *same, runs)
        for what in config.what
        for variant in variants[what]
        for agents in (config.num_agents if what == "env" else config.num_agents[:1])
        for lots in config.batches
        for runs in (config.runs if what == "ppo" else (1,))
    ]


def main(config: BenchmarkConfig) -> int:
    """Measures and prints the table; returns 1 if a process failed."""
    try:
        found = measure(jobs_of(config), run_job, config.repeats, config.out)
    except WorkerError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    print(start_table(found) if "start" in config.what else table(found))
    return 0


def measure(
    jobs: Sequence[Job], run: Callable[[Job], list[Result]], repeats: int, out: str = ""
) -> dict[Job, list[Result]]:
    """Runs all jobs in each of `repeats` rounds; prints results on stderr.

    All are written to the CSV file `out`, if given, after each job.
    """
    found: dict[Job, list[Result]] = {job: [] for job in jobs}
    rows: list[Result] = []
    if out:  # refuses an impossible path before anything is measured
        write_csv(Path(out), [])
    for number in range(1, repeats + 1):
        for job in jobs:
            results = run(job)
            found[job] += results
            rows += [{"round": number, **result} for result in results]
            if out:
                write_csv(Path(out), rows)
            for result in results:
                cells = (f"{k} {tables.cell_text(x)}" for k, x in result.items())
                print(f"round {number}: {', '.join(cells)}", file=sys.stderr)
    return found


def table(rounds: Mapping[Job, Sequence[Result]]) -> str:
    """The best rounds in Markdown, under a line that names device and versions.

    Other work on the machine can only slow a program down.
    """
    about = next(iter(rounds.values()))[0]
    rows: list[dict[str, Any]] = []
    for results in rounds.values():
        rate = max(result["rate"] for result in results)
        compile_s = min(result["compile_s"] for result in results)
        memory = max(result["peak_memory_mb"] for result in results)
        row = {name: results[0][name] for name in ("what", "layout", "agents")}
        row |= {"lots": f"{results[0]['lots']:,}", "rate": f"{rate:,.0f}"}
        row |= {"unit": results[0]["unit"], "compile [s]": f"{compile_s:,.1f}"}
        rows.append(row | {"peak memory [MB]": f"{memory:,.1f}"})
    machine = f"{about['device']}, JAX {about['jax']}, MuJoCo {about['mujoco']}"
    return f"{machine}\n\n{tables.markdown(rows)}"


def start_table(found: Mapping[Job, Sequence[Result]]) -> str:
    """Medians of the rounds of starts, in Markdown."""
    rows: list[dict[str, Any]] = []
    for job, results in found.items():
        row: dict[str, Any] = {"environment": job.variant, "lots": f"{job.lots:,}"}
        for part in ("reset", "step"):
            row[f"{part} equations"] = f"{results[0][f'{part}_equations']:,}"
        for process in ("first", "second"):
            these = [one for one in results if one["process"] == process]
            for phase in PHASES:
                seconds = statistics.median(one[phase] for one in these)
                row[f"{process}: {phase.removesuffix('_s')} [s]"] = f"{seconds:.1f}"
        rows.append(row)
    return tables.markdown(rows)


def run_job(job: Job) -> list[Result]:
    """Measures a job in a fresh process, without kept compiled programs.

    Of a start in two processes; the second finds what the first has compiled.
    """
    variables = {**os.environ}
    variables.pop("JAX_COMPILATION_CACHE_DIR", None)
    if job.what != "start":
        return [_run(job, variables | {"JAX_ENABLE_COMPILATION_CACHE": "false"})]
    if variables.get("XLA_FLAGS", "").startswith(OUTPUT_FUSION):  # our commands' own
        del variables["XLA_FLAGS"]
    with tempfile.TemporaryDirectory() as kept:
        variables["XDG_CACHE_HOME"] = kept
        return [{"process": x} | _run(job, variables) for x in ("first", "second")]


def _run(job: Job, variables: dict[str, str]) -> Result:
    """What a process of these variables reports of a job; its failure is an error."""
    request = {"started": time.time(), **dataclasses.asdict(job)}
    done = subprocess.run(
        [sys.executable, "-c", WORKER, json.dumps(request)],
        env=variables,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return json.loads(done.stdout.splitlines()[-1])
    message = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
    if done.returncode == 2:
        raise ValueError(message[0])
    if done.returncode == -signal.SIGINT:  # the process was interrupted first
        raise KeyboardInterrupt
    if done.returncode < 0:  # its stderr does not explain the signal
        message = [f"killed by signal {-done.returncode}, possibly out of memory"]
    about = f"{job.what} {job.variant} with {job.lots} lots"
    raise WorkerError(f"could not measure {about}: {message[0]}")


def work(argument: str) -> int:
    """Measures the job of a JSON object and prints another; returns the exit code."""
    request = json.loads(argument)
    started = request.pop("started")
    try:
        job = Job(**request)
        found = measure_start(job, started) if job.what == "start" else measure_job(job)
    except ValueError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    except Exception as error:
        traceback.print_exc()
        # The caller shows the last line, which JAX gives to a note of its own.
        reason = str(error).partition("\n")[0]
        print(f"{type(error).__name__}: {reason}", file=sys.stderr)
        return 1
    print(json.dumps(found))
    return 0


@dataclasses.dataclass(frozen=True)
class Subject:
    """A program to be measured."""

    what: str  # name in the table: with preset and runs, or with tyres and substep
    layout: str
    agents: int  # in each lot
    unit: str  # what is counted
    count: int  # units per call
    program: Any  # jitted `carry -> (carry, outputs)`
    carry: Any  # of the first call


def env_subject(job: Job) -> Subject:
    """Steps of `ParkingEnv` with random actions and respawning agents."""
    from carpark_mj.env import ParkingEnv

    config = EnvConfig(
        layout=job.variant,
        num_agents=job.num_agents,
        num_parked_cars=job.num_parked_cars,
    )
    env = ParkingEnv(config)
    shape = (job.lots, job.num_agents, env.action_spec.size)

    def step(carry: Any, _: None) -> tuple[Any, Any]:
        state, key = carry
        key, action_key = jax.random.split(key)
        action = jax.random.uniform(action_key, shape, minval=-1.0)
        state, timestep = jax.vmap(env.step)(state, action)
        # Without a use of the observation XLA would leave it out.
        seen = jnp.sum(timestep.observation, axis=-1)
        ended = timestep.terminated | timestep.truncated
        return (state, key), (seen, timestep.reward, ended)

    reset_key, key = jax.random.split(jax.random.key(0))
    state, _ = jax.jit(jax.vmap(env.reset))(jax.random.split(reset_key, job.lots))
    return Subject(
        what="env",
        layout=job.variant,
        agents=job.num_agents,
        unit="agent-steps",
        count=job.lots * job.num_agents * job.steps,
        program=scan(step, job.steps),
        carry=(state, key),
    )


def ppo_subject(job: Job) -> Subject:
    """Whole updates of PPO: simulation, observation, learning."""
    # Before any array is made: on CPUs it divides the lots over the cores.
    configure_jax()
    from carpark_mj.training.ppo.group import make_learner
    from carpark_mj.training.ppo.parts import PRESETS

    name = job.variant
    if name == "auto":
        name = "gpu" if jax.default_backend() == "gpu" else "cpu"
    config = dataclasses.replace(PRESETS[name], num_lots=job.lots)
    what = f"ppo {name}"
    seeds = range(job.runs)
    learner = make_learner([dataclasses.replace(config, seed=k) for k in seeds])
    program = learner.compile()
    if job.runs > 1:
        program = jax.jit(program, donate_argnums=0)
        what += f", {job.runs} runs"
    layout, carry = config.env.layout, learner.init()
    present = carry.env.info.get("present")  # None: all always are
    share = 1.0 if present is None else float(jnp.mean(present))
    return Subject(
        what=what,
        layout=layout if isinstance(layout, str) else layout.family,
        agents=config.env.num_agents,
        unit="agent-steps",
        count=round(share * job.runs * config.slots_per_update),
        program=program,
        carry=carry,
    )


def physics_subject(job: Job) -> Subject:
    """Cars alone, at the longest substep at which they pass the physics report."""
    from carpark_mj.physics.mjx import MjxPhysics
    from carpark_mj.physics.mjx_step import ContactPhysics
    from carpark_mj.vehicle import make_vehicle, preset

    sim, back_end = SimConfig(), MjxPhysics
    if job.variant == "contact":
        sim = SimConfig(sim_dt=CONTACT_SIM_DT, tyres="contact")
        back_end = ContactPhysics
    elif job.variant == "mjx.step":
        sim = SimConfig(stepper="mjx")
    physics: Any = back_end(sim)

    def step(carry: Any, _: None) -> tuple[Any, None]:
        state, key = carry
        key, control_key = jax.random.split(key)
        controls = jax.random.uniform(control_key, (job.lots, 2), minval=-1.0)
        return (physics.step(state, controls), key), None

    vehicle = make_vehicle(preset("compact"))
    fleet = jax.tree.map(lambda x: jnp.broadcast_to(x, (job.lots, *x.shape)), vehicle)
    state = physics.init(jnp.zeros((job.lots, 3)), fleet)
    return Subject(
        what=f"physics {job.variant} {1e3 * sim.sim_dt:g} ms",
        layout="",
        agents=1,
        unit="car-substeps",
        count=job.lots * job.steps * sim.num_substeps,
        program=scan(step, job.steps),
        carry=(state, jax.random.key(0)),
    )


SUBJECTS: dict[str, Callable[[Job], Subject]] = {
    "env": env_subject,
    "ppo": ppo_subject,
    "physics": physics_subject,
}


def scan(step: Callable[[Any, None], tuple[Any, Any]], steps: int) -> Any:
    """The jitted program of some steps in a row."""
    return jax.jit(lambda carry: jax.lax.scan(step, carry, None, length=steps))


def measure_job(job: Job) -> Result:
    """Compiles and times a job.

    `rate` is in units per second of the clock, `compile_s` the time of tracing,
    lowering and compiling, `peak_memory_mb` that of the first GPU, or of the process on
    a CPU [1e6 bytes].
    """
    if job.what != "physics" or job.variant == "brush":  # MJX refuses it
        enable_output_fusion()
    subject = SUBJECTS[job.what](job)
    clock = CLOCKS[job.clock]
    begun = clock()
    compiled = subject.program.lower(subject.carry).compile()
    compile_s = clock() - begun
    carry = subject.carry

    def call() -> Any:
        nonlocal carry
        carry, outputs = compiled(carry)
        return carry, outputs

    jax.block_until_ready(call())
    device = jax.devices()[0]
    on_cpu = device.platform == "cpu"
    return {
        "device": f"{os.cpu_count()} CPU cores" if on_cpu else device.device_kind,
        "jax": jax.__version__,
        "mujoco": mujoco.__version__,
        "what": subject.what,
        "layout": subject.layout,
        "agents": subject.agents,
        "lots": job.lots,
        "rate": subject.count / best_time(call, job.timings, clock),
        "unit": f"{subject.unit}/{'s' if job.clock == 'wall' else 'CPU s'}",
        "compile_s": compile_s,
        "peak_memory_mb": _peak_memory() / 1e6,
    }


def best_time(
    call: Callable[[], Any],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Seconds of the fastest of some calls, each until its results are computed."""
    best = float("inf")
    for _ in range(repeats):
        begun = clock()
        jax.block_until_ready(call())
        best = min(best, clock() - begun)
    return best


def _peak_memory() -> int:
    """Most memory used so far [bytes]: of the first GPU, or of this process."""
    stats = jax.devices()[0].memory_stats()
    if stats is not None and "peak_bytes_in_use" in stats:
        return stats["peak_bytes_in_use"]
    # Not `getrusage`: its maximum includes the process that started this one.
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024


def measure_start(job: Job, started: float) -> Result:
    """Seconds until the first step of an environment, compiling included.

    `import_s` is from the start of the process, at `started` [s], to the end of the
    import, `reset_s` until the first states are there, `step_s` until those after a
    step are. Equations are of the traced programs, loops counted once.
    """
    last, seconds = started, dict[str, float]()

    def lap(phase: str) -> None:
        nonlocal last
        now = time.time()
        seconds[phase], last = now - last, now

    from carpark_mj.env import ParkingEnv

    if job.lots == 1:
        compile_for_one_lot()
    lap("import_s")
    env = ParkingEnv(_environment(job.variant))
    lap("construct_s")
    keys = jax.random.split(jax.random.key(0), job.lots)
    state, _ = jax.block_until_ready(jax.jit(jax.vmap(env.reset))(keys))
    lap("reset_s")
    action = jnp.zeros((job.lots, env.num_agents, env.action_spec.size))
    jax.block_until_ready(jax.jit(jax.vmap(env.step))(state, action))
    lap("step_s")
    first = jax.tree.map(lambda x: x[0], state)
    reset, step = (
        count_equations(jax.make_jaxpr(function)(*given).jaxpr)
        for function, given in ((env.reset, keys[:1]), (env.step, (first, action[0])))
    )
    return {
        "environment": job.variant,
        "lots": job.lots,
        "device": jax.devices()[0].device_kind,
        **seconds,
        "total_s": last - started,
        "reset_equations": reset,
        "step_equations": step,
    }


def _environment(name: str) -> EnvConfig:
    return EnvConfig() if name == "default" else environment(name)


def count_equations(jaxpr: Any) -> int:
    """Equations of a traced program, those of its loops and branches included."""
    count = 0
    for equation in jaxpr.eqns:
        inner = [
            getattr(part, "jaxpr", part)
            for value in equation.params.values()
            for part in (value if isinstance(value, tuple | list) else (value,))
        ]
        inner = [part for part in inner if hasattr(part, "eqns")]
        # A call counts as what it calls.
        count += sum(map(count_equations, inner))
        count += not inner or equation.primitive.name in ("while", "scan", "cond")
    return count

"""`carpark_mj benchmark`: steps, training, physics, compilation and memory.

Every job is measured in a process of its own, by `work`.
"""

import dataclasses
import json
import os
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from carpark_mj.benchmarking import start
from carpark_mj.benchmarking.measuring import CLOCKS, WorkerError, best_time, run_worker
from carpark_mj.cli.process import configure_jax, enable_output_fusion
from carpark_mj.cli.settings.tables import BenchmarkConfig, Clock, What
from carpark_mj.config import CONTACT_SIM_DT, EnvConfig, SimConfig
from carpark_mj.evaluation import tables
from carpark_mj.files import write_csv


@dataclasses.dataclass(frozen=True)
class Job:
    """The measurement of one process; see `BenchmarkConfig`."""

    what: What
    variant: str  # layout of `env`, preset of `ppo`, tyres or stepper of `physics`
    lots: int  # simulated at once; for `physics`, cars
    num_agents: int  # in each lot of `env`; `ppo` and `physics` have their own
    num_parked_cars: int  # in each lot of `env`
    steps: int
    timings: int
    clock: Clock
    runs: int = 1


@dataclasses.dataclass(frozen=True)
class Measurement:
    """Results of a process."""

    device: str  # the GPU's name, or the number of CPU cores
    jax: str  # version
    mujoco: str  # version
    what: str  # with the preset and runs of `ppo`, or tyres and substep of `physics`
    layout: str  # empty for `physics`
    agents: int  # in each lot
    lots: int  # simulated at once
    rate: float  # units per second of the clock
    unit: str  # counted unit, per second of which clock
    compile_s: float  # tracing, lowering and compiling [s of the clock]
    peak_memory_mb: float  # of the first GPU, or of the process on a CPU [1e6 bytes]

    @property
    def progress(self) -> str:
        """What a round has found, in a line."""
        return (
            f"{self.what} {self.layout}, {self.lots:,} lots: {self.rate:,.0f} "
            f"{self.unit}, compiled in {self.compile_s:.1f} s"
        )


# Other work on the machine can only slow a program down: the best round counts.
BEST: dict[str, Callable[[Sequence[float]], float]] = {
    "rate": max,
    "compile_s": min,
    "peak_memory_mb": max,
}


def jobs_of(config: BenchmarkConfig) -> list[Job]:
    """What each round measures."""
    variants = {"env": config.layouts, "ppo": (config.preset,), "physics": config.cars}
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
        if config.what == ("start",):
            cases = start.cases_of(config.environments, config.batches)
            found = measure(cases, start.run, config.repeats, config.out)
            table = tables.markdown(start.rows(found))
        else:
            jobs = jobs_of(config)
            table = markdown(measure(jobs, run_job, config.repeats, config.out))
    except WorkerError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return 1
    print(table)
    return 0


def measure(
    cases: Sequence[Any], run: Callable[[Any], list[Any]], repeats: int, out: str = ""
) -> dict[Any, list[Any]]:
    """Runs all cases in each of `repeats` rounds; prints progress on stderr.

    All results, dataclasses with a `progress`, are written to the CSV file `out`, if
    given, after each. Raises `WorkerError` if a process failed.
    """
    found: dict[Any, list[Any]] = {case: [] for case in cases}
    rows: list[dict[str, Any]] = []
    if out:  # refuses an impossible path before anything is measured
        write_csv(Path(out), [])
    for number in range(1, repeats + 1):
        for case in cases:
            results = run(case)
            found[case] += results
            rows += [{"round": number, **dataclasses.asdict(x)} for x in results]
            if out:
                write_csv(Path(out), rows)
            for result in results:
                print(f"round {number}: {result.progress}", file=sys.stderr)
    return found


WORKER = (
    "import sys; from carpark_mj.benchmarking import work; sys.exit(work(sys.argv[1]))"
)


def run_job(job: Job) -> list[Measurement]:
    """Measures a job in a fresh process, without kept compiled programs."""
    environment = {**os.environ, "JAX_ENABLE_COMPILATION_CACHE": "false"}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    about = f"{job.what} {job.variant} with {job.lots} lots"
    found = run_worker(WORKER, dataclasses.asdict(job), environment, about)
    return [Measurement(**found)]


def markdown(rounds: Mapping[Job, Sequence[Measurement]]) -> str:
    """The table of the best rounds, under a line that names device and versions."""
    about = next(iter(rounds.values()))[0]
    rows: list[dict[str, Any]] = []
    for results in rounds.values():
        one = results[0]
        best = [f([getattr(r, name) for r in results]) for name, f in BEST.items()]
        rate, *others = best
        row = {"what": one.what, "layout": one.layout, "agents": one.agents}
        row |= {"lots": f"{one.lots:,}", "rate": f"{rate:,.0f}", "unit": one.unit}
        names = "compile [s]", "peak memory [MB]"
        row |= {n: f"{x:,.1f}" for n, x in zip(names, others, strict=True)}
        rows.append(row)
    about_machine = f"{about.device}, JAX {about.jax}, MuJoCo {about.mujoco}"
    return f"{about_machine}\n\n{tables.markdown(rows)}"


@dataclasses.dataclass(frozen=True)
class Subject:
    """A program to be measured."""

    what: str  # name in the table
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
    from carpark_mj.training.ppo.group import GroupLearner
    from carpark_mj.training.ppo.learner import Learner
    from carpark_mj.training.ppo.parts import PRESETS

    name = job.variant
    if name == "auto":
        name = "gpu" if jax.default_backend() == "gpu" else "cpu"
    config = dataclasses.replace(PRESETS[name], num_lots=job.lots)
    what = f"ppo {name}"
    if job.runs == 1:
        learner = Learner(config)
        program = learner.compile()
    else:
        configs = [dataclasses.replace(config, seed=k) for k in range(job.runs)]
        learner = GroupLearner(configs)
        program = jax.jit(learner.compile(), donate_argnums=0)
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


def measure_job(job: Job) -> Measurement:
    """Compiles and times a job."""
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
    return Measurement(
        device=device_name(),
        jax=jax.__version__,
        mujoco=mujoco.__version__,
        what=subject.what,
        layout=subject.layout,
        agents=subject.agents,
        lots=job.lots,
        rate=subject.count / best_time(call, job.timings, clock),
        unit=f"{subject.unit}/{'s' if job.clock == 'wall' else 'CPU s'}",
        compile_s=compile_s,
        peak_memory_mb=peak_memory() / 1e6,
    )


def device_name() -> str:
    """JAX's device: the GPU's name, or the number of CPU cores."""
    device, cores = jax.devices()[0], f"{os.cpu_count()} CPU cores"
    return cores if device.platform == "cpu" else device.device_kind


def peak_memory() -> int:
    """Most memory used so far [bytes]: of the first GPU, or of this process."""
    stats = jax.devices()[0].memory_stats()
    if stats is not None and "peak_bytes_in_use" in stats:
        return stats["peak_bytes_in_use"]
    # Not `getrusage`: its maximum includes the process that started this one.
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    raise OSError("the kernel does not report the peak memory of a process")


def work(argument: str) -> int:
    """Measures the job of a JSON object and prints another; returns the exit code."""
    try:
        measurement = measure_job(Job(**json.loads(argument)))
    except ValueError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    except Exception as error:
        traceback.print_exc()
        # The caller shows the last line, which JAX gives to a note of its own.
        reason = str(error).partition("\n")[0]
        print(f"{type(error).__name__}: {reason}", file=sys.stderr)
        return 1
    print(json.dumps(dataclasses.asdict(measurement)))
    return 0

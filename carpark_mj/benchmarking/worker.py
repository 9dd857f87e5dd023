"""Measures one job in its own process.

It takes one JSON object and prints another; bad input gives exit code 2 and one line.
"""

import dataclasses
import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco

from carpark_mj.benchmarking.report import Job, Measurement
from carpark_mj.cli.common import configure_jax, enable_output_fusion

# What is called a second: of the wall clock, or of all threads of this process, which
# other work on the machine disturbs far less.
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}


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


@dataclasses.dataclass(frozen=True)
class Subject:
    """A program to be measured.

    Attributes:
        what: name in the table.
        layout: layout of its lots.
        agents: number of agents in each lot.
        unit: what is counted.
        count: units per call.
        program: jitted `carry -> (carry, outputs)`.
        carry: carry of the first call.
    """

    what: str
    layout: str
    agents: int
    unit: str
    count: int
    program: Any
    carry: Any


def env_subject(job: Job) -> Subject:
    """Steps of `ParkingEnv` with random actions and respawning agents."""
    from carpark_mj.config import EnvConfig
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
    if name not in PRESETS:
        raise ValueError(f"unknown preset {name!r}; choose from {sorted(PRESETS)}")
    config = dataclasses.replace(PRESETS[name], num_lots=job.lots)
    what = f"ppo {name}"
    if job.runs == 1:
        learner = Learner(config)
        program = learner.compile()
    else:
        seeds = range(job.runs)
        configs = [dataclasses.replace(config, seed=seed) for seed in seeds]
        learner = GroupLearner(configs)
        program = jax.jit(learner.compile(), donate_argnums=0)
        what += f", {job.runs} runs"
    layout, carry = config.env.layout, learner.init()
    present = carry.env.info.get("present")  # None: all always are
    slots = job.runs * config.slots_per_update
    share = 1.0 if present is None else float(jnp.mean(present))
    return Subject(
        what=what,
        layout=layout if isinstance(layout, str) else layout.family,
        agents=config.env.num_agents,
        unit="agent-steps",
        count=round(share * slots),
        program=program,
        carry=carry,
    )


def physics_subject(job: Job) -> Subject:
    """Cars alone, at the longest substep at which they pass the physics report."""
    from carpark_mj.config import CONTACT_SIM_DT, SimConfig
    from carpark_mj.physics.mjx import MjxPhysics
    from carpark_mj.physics.mjx_step import ContactPhysics
    from carpark_mj.vehicle import make_vehicle, preset

    if job.variant == "contact":
        sim = SimConfig(sim_dt=CONTACT_SIM_DT, tyres="contact")
        physics: Any = ContactPhysics(sim)
    else:
        sim = SimConfig()
        if job.variant == "mjx.step":
            sim = dataclasses.replace(sim, stepper="mjx")
        physics = MjxPhysics(sim)

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


def set_flags(job: Job) -> None:
    """Sets XLA's flags as the programs do."""
    if job.what != "physics" or job.variant == "brush":  # MJX refuses them
        enable_output_fusion()


def measure(job: Job, started: float) -> Measurement:
    """Compiles and times a job.

    Args:
        job: what to measure.
        started: `time.time()` when this process was started [s].

    Raises:
        ValueError: settings that the environment or the preset refuses.
    """
    set_flags(job)
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
    # The process's own clock begins with it.
    first_step_s = time.time() - started if job.clock == "wall" else clock()
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
        first_step_s=first_step_s,
        peak_memory_mb=peak_memory() / 1e6,
    )


def device_name() -> str:
    """JAX's device: the GPU's name, or the number of CPU cores."""
    device = jax.devices()[0]
    if device.platform == "cpu":
        return f"{os.cpu_count()} CPU cores"
    return device.device_kind


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


def main(argument: str) -> int:
    """Measures the job of a JSON object; returns the exit code."""
    request = json.loads(argument)
    try:
        measurement = measure(Job(**request["job"]), request["started"])
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))

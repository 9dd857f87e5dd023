"""`carpark_mj benchmark --what start`: how long a person waits for the first step."""

import dataclasses
import itertools
import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from carpark_mj.benchmarking.measuring import run_worker
from carpark_mj.cli.process import OUTPUT_FUSION
from carpark_mj.config import EnvConfig
from carpark_mj.registry import environment

WORKER = "import sys; from carpark_mj.benchmarking.start import work; work(sys.argv[1])"
# Seconds that a process reports, in the order in which it spends them.
PHASES = ("import_s", "construct_s", "reset_s", "step_s", "total_s")


@dataclasses.dataclass(frozen=True)
class Start:
    """Seconds until the first step of an environment in one process.

    Tracing, compiling and running count. The second process finds the compiled programs
    that the first has kept.
    """

    environment: str  # a registered name, or `default`
    lots: int
    process: str  # `first` or `second`
    device: str
    import_s: float  # from the start of the process to the end of the import
    construct_s: float
    reset_s: float  # until the first states are there
    step_s: float  # until the states after a step are there
    total_s: float
    reset_equations: int  # of the traced programs, loops counted once
    step_equations: int

    @property
    def progress(self) -> str:
        """What a round has found, in a line."""
        about = f"{self.environment}, {self.lots:,} lots, {self.process} process"
        return f"{about}: {self.total_s:.1f} s"


def cases_of(
    environments: Sequence[str], batches: Sequence[int]
) -> list[tuple[str, int]]:
    """What each round measures; `ValueError` of an unknown environment."""
    for name in environments:
        _config(name)
    return list(itertools.product(environments, batches))


def run(case: tuple[str, int]) -> list[Start]:
    """Measures a first and a second process of an environment and its lots."""
    with tempfile.TemporaryDirectory() as kept:
        return [_run(*case, process, kept) for process in ("first", "second")]


def rows(found: Mapping[tuple[str, int], Sequence[Start]]) -> list[dict[str, Any]]:
    """The rows of the table: medians over the rounds."""
    table: list[dict[str, Any]] = []
    for (name, lots), cases in found.items():
        row: dict[str, Any] = {"environment": name, "lots": f"{lots:,}"}
        row |= {
            f"{part} equations": f"{getattr(cases[0], f'{part}_equations'):,}"
            for part in ("reset", "step")
        }
        for process in ("first", "second"):
            these = [one for one in cases if one.process == process]
            seconds = {k: median(getattr(one, k) for one in these) for k in PHASES}
            row |= {
                f"{process}: {name.removesuffix('_s')} [s]": f"{x:.1f}"
                for name, x in seconds.items()
            }
        table.append(row)
    return table


def _run(name: str, lots: int, process: str, kept: str) -> Start:
    """Measures one process that keeps its programs in a folder."""
    request = {"name": name, "lots": lots, "started": time.time()}
    environment = {**os.environ, "XDG_CACHE_HOME": kept}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    if environment.get("XLA_FLAGS", "").startswith(OUTPUT_FUSION):  # our commands' own
        del environment["XLA_FLAGS"]
    about = f"{name} with {lots} lots"
    return Start(process=process, **run_worker(WORKER, request, environment, about))


def work(argument: str) -> None:
    """Measures what a JSON object asks for, and prints another."""
    request = json.loads(argument)
    name, lots, last = request["name"], request["lots"], request["started"]
    seconds: dict[str, float] = {}

    def lap(phase: str) -> None:
        nonlocal last
        now = time.time()
        seconds[phase], last = now - last, now

    import jax
    import jax.numpy as jnp

    from carpark_mj.env import ParkingEnv

    lap("import_s")
    env = ParkingEnv(_config(name))
    lap("construct_s")
    keys = jax.random.split(jax.random.key(0), lots)
    reset = jax.jit(jax.vmap(env.reset))
    state, _ = jax.block_until_ready(reset(keys))
    lap("reset_s")
    action = jnp.zeros((lots, env.num_agents, env.action_spec.size))
    step = jax.jit(jax.vmap(env.step))
    jax.block_until_ready(step(state, action))
    lap("step_s")
    total, first = time.time() - request["started"], jax.tree.map(lambda x: x[0], state)
    result = {
        "environment": name,
        "lots": lots,
        "device": jax.devices()[0].device_kind,
        **seconds,
        "total_s": total,
        "reset_equations": count_equations(jax.make_jaxpr(env.reset)(keys[0]).jaxpr),
        "step_equations": count_equations(
            jax.make_jaxpr(env.step)(first, action[0]).jaxpr
        ),
    }
    print(json.dumps(result))


def _config(name: str) -> EnvConfig:
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

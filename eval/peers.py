"""Compares adapters with the core, and highway-env with adapters, in one session.

    python eval/peers.py core --lots 1024 --rounds 8
    python eval/peers.py highway-env --lots 1024    # pip install -e ".[sb3,peers]"

All programs are compiled first and then take turns, so that other work on the machine
affects all alike; the best turn of each counts.
"""

from carpark_mj.cli.process import enter

if __name__ == "__main__":  # before the imports, which take seconds
    enter("peers", "peers:main")

# Extras that the type checker does without.
# pyright: reportMissingImports=false

import contextlib
import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium
import jax
import numpy as np
import tyro

from carpark_mj.config import EnvConfig, EpisodeConfig
from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.env import ParkingEnv
from carpark_mj.evaluation.tables import markdown
from carpark_mj.wrappers.batch import Batch, NumpyBatch
from carpark_mj.wrappers.options import share
from shell import command

Peer = Literal["core", "highway-env"]
PARKING = "highway_env:parking-v0"
GOAL, MANY = "carpark_mj/ParkGoal-v0", "carpark_mj/ParkMany-v0"


class Subject(NamedTuple):
    """A program: a `step` moves all of its `agents` under random actions.

    It is compared with the subject whose name is `beside`; empty = with none.
    """

    name: str
    agents: int
    step: Callable[[], object]
    beside: str = ""


def core(lots: int, stack: contextlib.ExitStack) -> list[Subject]:
    """The compiled step of respawning agents, alone and through adapters."""
    import torch

    from carpark_mj.wrappers.sb3 import ParkVecEnv
    from carpark_mj.wrappers.torch_batch import TorchBatch

    episode = EpisodeConfig(final_observation=True)
    env = share(ParkingEnv, EnvConfig(num_agents=1, episode=episode))
    batches = Batch(env, lots), NumpyBatch(env, lots), TorchBatch(env, lots)
    for each in batches:
        each.reset(0)
    batch, numpy_batch, torch_batch = batches
    action = random_actions((lots, 1, 2))
    tensor = torch.as_tensor(action, device=torch_batch.device)
    vector = gymnasium.make_vec(MANY, lots, agents=1)
    first, vec_env = "core, JAX", ParkVecEnv(MANY, lots, agents=1)
    for each in (vector, vec_env):
        stack.enter_context(contextlib.closing(each))
    return [
        Subject(first, lots, lambda: jax.block_until_ready(batch.step(action))),
        Subject("NumPy batch", lots, lambda: numpy_batch.step_numpy(action), first),
        Subject("torch batch", lots, lambda: torch_batch.step(tensor), first),
        Subject("Gymnasium vector", lots, stepper(vector), first),
        Subject("SB3 VecEnv", lots, stepper(vec_env), first),
    ]


def highway(lots: int, stack: contextlib.ExitStack) -> list[Subject]:
    """highway-env's parking and ParkGoal: one car, a goal pose, an empty lot.

    highway-env steps one car at a time, so it gets a process for every core.
    """
    import highway_env  # noqa: F401  # pyright: ignore[reportUnusedImport]
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from carpark_mj.wrappers.sb3 import ParkVecEnv

    cores = os.cpu_count() or 1
    spawn: Any = {"vectorization_mode": "async", "vector_kwargs": {"context": "spawn"}}
    pairs: dict[str, tuple[Any, Any]] = {
        "single": (gymnasium.make(PARKING), gymnasium.make(GOAL, parked_cars=0)),
        "vectorised": (
            gymnasium.make_vec(PARKING, cores, **spawn),
            gymnasium.make_vec(GOAL, lots, parked_cars=0),
        ),
        "SB3 VecEnv": (
            SubprocVecEnv([lambda: gymnasium.make(PARKING)] * cores, "spawn"),
            ParkVecEnv(GOAL, lots, parked_cars=0),
        ),
    }
    found: list[Subject] = []
    for how, pair in pairs.items():
        beside = ""
        for whose, env in zip(("highway-env", "carpark_mj"), pair, strict=True):
            stack.enter_context(contextlib.closing(env))
            agents, name = getattr(env, "num_envs", 1), f"{whose}, {how}"
            found.append(Subject(name, agents, stepper(env), beside))
            beside = name
    return found


def stepper(env: Any) -> Callable[[], object]:
    """A step of a Gymnasium environment, one or many, or of a `VecEnv`."""
    env.reset()
    num_envs = getattr(env, "num_envs", None)
    action = random_actions((num_envs, 2) if num_envs else (2,))

    def step() -> None:
        result = env.step(action)
        if num_envs is None and (result[2] or result[3]):
            env.reset()

    return step


def random_actions(shape: tuple[int, ...]) -> np.ndarray:
    """Actions, uniform in [-1, 1]; every car holds its own."""
    return np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)


def take_turns(
    found: Sequence[Subject], rounds: int, seconds: float = 1.0
) -> dict[str, list[float]]:
    """Agent steps/s by name and round; all step in turn, each for some seconds."""
    rates: dict[str, list[float]] = {subject.name: [] for subject in found}
    for subject in found:  # compiles
        subject.step()
        subject.step()
    for _ in range(rounds):
        for subject in found:
            begun, steps = time.perf_counter(), 0
            while (gone := time.perf_counter() - begun) < seconds:
                subject.step()
                steps += 1
            rates[subject.name].append(steps * subject.agents / gone)
    return rates


def comparison(found: Sequence[Subject], rates: dict[str, list[float]]) -> str:
    """A markdown table: best rates, their ratios, and the range over the rounds."""
    rows = []
    for subject in found:
        own, other, ratio = rates[subject.name], rates.get(subject.beside), ""
        if other:
            pairs = [a / b for a, b in zip(own, other, strict=True)]
            best = max(own) / max(other)
            ratio = f"{best:.3g} ({min(pairs):.3g} … {max(pairs):.3g})"
        row = {"what": subject.name, "agents": f"{subject.agents:,}"}
        rows.append(row | {"agent steps/s": f"{max(own):,.0f}", "ratio": ratio})
    return markdown(rows, left=1)


@dataclasses.dataclass(frozen=True)
class PeersConfig(CheckedConfig):
    """Settings of the comparison.

    Attributes:
        peer: `core`, the compiled step that adapters wrap, or `highway-env`.
        lots: simulated at once.
        rounds: turns of each program.
    """

    peer: Annotated[Peer, tyro.conf.Positional]
    lots: Count = 128
    rounds: Count = 3


def compare(config: PeersConfig) -> None:
    """Prints the comparison."""
    programs = {"core": core, "highway-env": highway}[config.peer]
    with contextlib.ExitStack() as stack:
        try:
            found = programs(config.lots, stack)
        except ModuleNotFoundError as error:
            raise ValueError(f'{error}: pip install -e ".[sb3,peers]"') from None
        print(comparison(found, take_turns(found, config.rounds)))


main = command(PeersConfig, compare, __doc__)

"""Compares highway-env's parking with ParkGoal: one car, a goal pose, an empty lot.

    python eval/peers.py --lots 1024    # pip install -e ".[sb3,peers]"

All programs are compiled first and then take turns, so that other work on the machine
affects all alike; the best turn of each counts. highway-env steps one car at a time, so
it gets a process for every core.
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
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from carpark_mj.config.checks import CheckedConfig, Count
from carpark_mj.evaluation.tables import markdown
from shell import command

PARKING, GOAL = "highway_env:parking-v0", "carpark_mj/ParkGoal-v0"


class Subject(NamedTuple):
    """A program: a `step` moves all of its `cars` under random actions."""

    name: str
    cars: int
    step: Callable[[], object]


def pairs(lots: int, stack: contextlib.ExitStack) -> list[list[Subject]]:
    """Environments of highway-env, each with that of carpark_mj."""
    import highway_env  # noqa: F401  # pyright: ignore[reportUnusedImport]
    from stable_baselines3.common.vec_env import SubprocVecEnv

    from carpark_mj.wrappers.sb3 import ParkVecEnv

    cores = os.cpu_count() or 1
    spawn: Any = {"vectorization_mode": "async", "vector_kwargs": {"context": "spawn"}}
    found: dict[str, tuple[Any, Any]] = {
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
    return [
        [
            Subject(
                f"{whose}, {how}",
                getattr(env, "num_envs", 1),
                stepper(stack.enter_context(contextlib.closing(env))),
            )
            for whose, env in zip(("highway-env", "carpark_mj"), pair, strict=True)
        ]
        for how, pair in found.items()
    ]


def stepper(env: Any) -> Callable[[], object]:
    """A step of a Gymnasium environment, one or many, or of a `VecEnv`."""
    env.reset()
    num_envs = getattr(env, "num_envs", None)
    shape = (num_envs, 2) if num_envs else (2,)
    action = np.random.default_rng(0).uniform(-1.0, 1.0, shape).astype(np.float32)

    def step() -> None:
        result = env.step(action)
        if num_envs is None and (result[2] or result[3]):
            env.reset()

    return step


def take_turns(
    found: Sequence[Subject], rounds: int, seconds: float = 1.0
) -> dict[str, list[float]]:
    """Steps of cars per second by name and round; each steps for some seconds."""
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
            rates[subject.name].append(steps * subject.cars / gone)
    return rates


def comparison(pair: Sequence[Subject], rates: dict[str, list[float]]) -> list[dict]:
    """Rows of a pair: best rates, their ratio, and its range over the rounds."""
    theirs, ours = (rates[subject.name] for subject in pair)
    each, best = np.divide(ours, theirs), max(ours) / max(theirs)
    ratios = "", f"{best:.3g} ({each.min():.3g} … {each.max():.3g})"
    return [
        {"what": name, "cars": f"{cars:,}", "steps/s": f"{max(rates[name]):,.0f}"}
        | {"ratio": ratio}
        for (name, cars, _), ratio in zip(pair, ratios, strict=True)
    ]


@dataclasses.dataclass(frozen=True)
class PeersConfig(CheckedConfig):
    """Settings of the comparison.

    Attributes:
        lots: simulated at once.
        rounds: turns of each program.
    """

    lots: Count = 128
    rounds: Count = 3


def compare(config: PeersConfig) -> None:
    """Prints the comparison."""
    with contextlib.ExitStack() as stack:
        try:
            found = pairs(config.lots, stack)
        except ModuleNotFoundError as error:
            raise ValueError(f'{error}: pip install -e ".[sb3,peers]"') from None
        rates = take_turns([one for pair in found for one in pair], config.rounds)
    print(markdown([row for pair in found for row in comparison(pair, rates)], left=1))


main = command(PeersConfig, compare, __doc__)

"""The runs of a sweep, checked before any of them starts."""

import dataclasses
import functools
import itertools
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote

from carpark_mj.config import EnvConfig
from carpark_mj.env import ParkingEnv
from carpark_mj.sweeps.axes import Axis, flags
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS, summaries
from carpark_mj.training.settings import read_settings

MAX_RUNS = 100_000
MAX_NAME = 200  # characters; file systems allow 255 bytes


@dataclasses.dataclass(frozen=True)
class Plan:
    """A sweep.

    Attributes:
        base: preset of all runs.
        axes: varied settings; a single value is fixed across runs.
        repeats: runs of every combination.
        seed: of the first run of a combination; run i uses seed + i.
    """

    base: str
    axes: tuple[Axis, ...]
    repeats: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.base not in PRESETS:
            raise ValueError(f"unknown base {self.base!r}; choose from {[*PRESETS]}")
        if self.repeats < 1:
            raise ValueError(f"repeats must be at least 1, not {self.repeats}")
        fields = [field for axis in self.axes for field in axis.fields]
        for field in fields:
            if fields.count(field) > 1:
                raise ValueError(f"{field} is given twice")
        if len(self) > MAX_RUNS:
            raise ValueError(f"a sweep has at most {MAX_RUNS} runs, not {len(self)}")

    def __len__(self) -> int:
        """Number of runs."""
        total = self.repeats
        for axis in self.axes:
            total *= len(axis.values)
        return total

    @property
    def definition(self) -> dict[str, Any]:
        """Common settings of all runs; sweeps in one folder must agree in them."""
        fixed = [axis for axis in self.axes if not axis.is_swept]
        return {
            "base": self.base,
            "fixed": {
                f: v for a in fixed for f, v in zip(a.fields, a.values[0], strict=True)
            },
            "swept": [list(axis.fields) for axis in self.axes if axis.is_swept],
        }


@dataclasses.dataclass(frozen=True)
class Run:
    """A run of a sweep.

    Attributes:
        name: of its folder, made of what differs between runs.
        base: preset.
        settings: dotted names and values, of all axes.
        swept: those of them that differ between runs.
        seed: random seed.
    """

    name: str
    base: str
    settings: tuple[tuple[str, str], ...]
    swept: tuple[str, ...]
    seed: int

    @property
    def arguments(self) -> list[str]:
        """Flags of `carpark_mj train` for the training, without its folder."""
        words = flags(dict(self.settings), PRESETS[self.base])
        return ["--preset", self.base, "--seed", str(self.seed), *words]


def runs(plan: Plan) -> Iterator[Run]:
    """All runs: the seeds of a combination one after the other."""
    swept = tuple(f for axis in plan.axes if axis.is_swept for f in axis.fields)
    for point in itertools.product(*(axis.values for axis in plan.axes)):
        settings = {
            field: value
            for axis, values in zip(plan.axes, point, strict=True)
            for field, value in zip(axis.fields, values, strict=True)
        }
        for seed in range(plan.seed, plan.seed + plan.repeats):
            parts = {field.rpartition(".")[2]: settings[field] for field in swept}
            if len(parts) < len(swept):  # two settings of the same last name
                parts = {field: settings[field] for field in swept}
            words = [f"{key}={quote(value, safe='+,')}" for key, value in parts.items()]
            name = ",".join([*words, f"seed={seed}"])
            yield Run(name, plan.base, tuple(settings.items()), swept, seed)


def checked_runs(plan: Plan) -> list[Run]:
    """All runs, each with settings that can be trained.

    Raises:
        ValueError: a run is impossible, or repeats another one, as with 0.1 and 0.10;
            the message names the run and the reason.
    """
    checked: list[Run] = []
    possible: set[EnvConfig] = set()
    known: dict[PPOConfig, Run] = {}
    for run in runs(plan):
        try:
            config = settings_of(run)
            if config.env not in possible:
                ParkingEnv(config.env)  # more cars than bays, for example
                possible.add(config.env)
        except ValueError as error:
            raise ValueError(f"{_describe(run)}: {error}") from None
        if known.setdefault(config, run) is not run:
            raise ValueError(
                f"{_describe(run)}: the same settings as {_describe(known[config])}"
            )
        if len(run.name) > MAX_NAME:
            raise ValueError(
                f"the names of runs are too long, {len(run.name)} characters: sweep "
                f"fewer settings at a time (at most {MAX_NAME} characters)"
            )
        checked.append(run)
    return checked


@functools.cache
def settings_of(run: Run) -> PPOConfig:
    """The trainer's settings of a run; no video unless the sweep asks for one.

    Raises:
        ValueError: impossible ones.
    """
    arguments = run.arguments
    if "video_seconds" not in dict(run.settings):
        arguments += ["--video-seconds", "0"]
    return read_settings(PRESETS[run.base], PRESETS, arguments, None, (), summaries())


def _describe(run: Run) -> str:
    settings = dict(run.settings)
    values = [f"{name}={settings[name]}" for name in run.swept]
    return ", ".join([run.base, *values])

"""What a sweep trains: settings and their values, the runs, groups of alike ones."""

import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from urllib.parse import quote

from carpark_mj.cli.flags import as_flags, read_flags
from carpark_mj.config import REWARD_TERMS, term_settings
from carpark_mj.extensions import unknown_name
from carpark_mj.training.ppo.config import PPOConfig
from carpark_mj.training.ppo.parts import PRESETS
from carpark_mj.training.run_folder import list_settings

MAX_RUNS = 100_000
MAX_NAME = 200  # characters; file systems allow 255 bytes
# What a sweep itself sets in every run.
OWN_FIELDS = ("preset", "name", "runs_dir", "resume", "time_limit", "seed")


@dataclasses.dataclass(frozen=True)
class Axis:
    """Settings that change together."""

    fields: tuple[str, ...]  # dotted names of settings, `env.num_agents`
    values: tuple[tuple[str, ...], ...]  # of all fields for every point, as words

    @property
    def is_swept(self) -> bool:
        """Whether it has several points."""
        return len(self.values) > 1


def read_axis(text: str, config: PPOConfig) -> Axis:
    """Reads `FIELD=VALUES`.

    VALUES are separated by commas, or by semicolons where a value has commas itself;
    `1..7` is a range of whole numbers, both ends included.
    """
    name, equals, values = text.partition("=")
    if not equals:
        raise ValueError(
            f"set takes FIELD=VALUES, for example num_agents=1..7, not {text!r}"
        )
    terms = [key for name in REWARD_TERMS for key in term_settings(name)]
    known = dict.fromkeys((f"env.reward.extra.{key}" for key in terms), 0.0)
    known |= dict(list_settings(config))
    field = _find_field(name.strip().replace("-", "_"), known)
    words: list[str] = []
    for part in values.removesuffix(";").split(";" if ";" in values else ","):
        ends = re.fullmatch(r"\s*(-?\d+)\.\.(-?\d+)\s*", part)
        first, last = map(int, ends.groups()) if ends else (0, -1)
        if last - first >= MAX_RUNS:
            raise ValueError(f"a sweep has at most {MAX_RUNS} runs, not {part.strip()}")
        words += map(str, range(first, last + 1)) if ends else [part.strip()]
    if not all(words) or not words or len({*words}) < len(words):
        raise ValueError(f"{field} has no values, or one twice, in {text!r}")
    return Axis((field,), tuple((word,) for word in words))


def _find_field(name: str, known: Mapping[str, Any]) -> str:
    """The dotted name of a setting, given in full or by an unambiguous suffix."""
    found = [path for path in known if f".{path}".endswith(f".{name}")]
    if name in known:
        found = [name]
    if not found:
        last = {path.rpartition(".")[2] for path in known}
        raise ValueError(unknown_name("setting", name, last))
    if len(found) > 1:
        raise ValueError(f"{name!r} is several settings: {', '.join(found)}")
    if found[0] in OWN_FIELDS:
        raise ValueError(f"{found[0]} is not swept: see the flags of the sweep")
    return found[0]


@dataclasses.dataclass(frozen=True)
class Plan:
    """A sweep."""

    base: str  # preset of all runs
    axes: tuple[Axis, ...]  # varied settings; a single value is fixed across runs
    repeats: int = 1  # runs of every combination
    seed: int = 0  # of the first run of a combination; run i uses seed + i

    def __post_init__(self) -> None:
        fields = [field for axis in self.axes for field in axis.fields]
        if twice := {field for field in fields if fields.count(field) > 1}:
            raise ValueError(f"{', '.join(twice)} is given twice")
        if len(self) > MAX_RUNS:
            raise ValueError(f"a sweep has at most {MAX_RUNS} runs, not {len(self)}")

    def __len__(self) -> int:
        """Number of runs."""
        return self.repeats * math.prod(len(axis.values) for axis in self.axes)

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
    """A run of a sweep."""

    name: str  # of its folder, made of what differs between runs
    base: str  # preset
    settings: tuple[tuple[str, str], ...]  # dotted names and values, of all axes
    swept: tuple[str, ...]  # settings that differ between runs
    seed: int  # random seed


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
            if len(parts) < len(swept):  # two settings with one last name
                parts = {field: settings[field] for field in swept}
            words = [f"{key}={quote(value, safe='+,')}" for key, value in parts.items()]
            name = ",".join([*words, f"seed={seed}"])
            yield Run(name, plan.base, tuple(settings.items()), swept, seed)


def checked_runs(plan: Plan) -> list[Run]:
    """All runs, each with settings that can be trained."""
    from carpark_mj.env import ParkingEnv

    possible: set[Any] = set()
    known: dict[PPOConfig, Run] = {}
    for run in runs(plan):
        where = ", ".join(f"{k}={v}" for k, v in run.settings if k in run.swept)
        try:
            config = settings_of(run)
            if config.env not in possible:
                ParkingEnv(config.env)  # more cars than bays, for example
                possible.add(config.env)
            if known.setdefault(config, run) is not run:
                raise ValueError(f"the same settings as {known[config].name}")
            if len(run.name) > MAX_NAME:
                raise ValueError(f"its name is longer than {MAX_NAME}: sweep less")
        except ValueError as error:
            raise ValueError(f"{plan.base}, {where}: {error}") from None
    return [*known.values()]


@functools.cache
def settings_of(run: Run) -> PPOConfig:
    """The trainer's settings of a run; no video unless the sweep asks for one."""
    base = PRESETS[run.base]
    flags = as_flags({"video_seconds": "0"} | dict(run.settings), base)
    return read_flags(PPOConfig, ["--seed", str(run.seed), *flags], base)


def groups(runs: Sequence[Run], size: int) -> list[tuple[Run, ...]]:
    """At most `size` runs each in one program: they differ in seeds and data only.

    A run that ends after some `minutes` is alone: others beside it would slow it down.
    """
    from carpark_mj.training.ppo.group import program

    alike: dict[Any, list[Run]] = {}
    for run in runs:
        config = settings_of(run)
        alone = size == 1 or config.minutes
        alike.setdefault(run.name if alone else program(config), []).append(run)
    return [
        tuple(members[start : start + size])
        for members in alike.values()
        for start in range(0, len(members), size)
    ]

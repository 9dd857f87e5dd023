"""Scenarios: a case of the user's own in a file, repeated with tolerances.

    lot: square_compact             # name or file of a layout
    vehicle: compact                # preset or data sheet
    start: [-3.0, -2.0, 0.0]        # centre of the car, x, y [m], heading [rad]
    goal: 7                         # a bay, or {pose: [x, y, heading], end: tail_first}
    parked: [6, 8]                  # bays with parked cars
    rule: precise                   # or {distance: 0.1, heading: 0.03, speed: 0.05}
    seconds: 60
    repetitions: 100
    spread: {place: 0.1, heading: 0.02}
    movers:
      - {kind: person, between: [6, 7], speed: 1.5, near: 6.0, spread: {near: 1.0}}
    settings: {sensors.position_noise: 0.05}

Movers are `carpark_mj.movers.scripted`. Repetition 0 is the scenario as it is written.
The others draw every value with a spread uniformly between the value less and plus the
spread. `carpark_mj scenario` drives a file; `scenario:FILE` is a level of the suite.
"""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj.config import EnvConfig, FleetConfig, LayoutConfig, MetricsConfig
from carpark_mj.config.checks import Bounds, CheckedConfig, Count, Natural, Positive
from carpark_mj.layouts.registry import FixedLayoutConfig, make_layout
from carpark_mj.layouts.standards import BAY_LENGTH, BAY_WIDTH
from carpark_mj.layouts.types import BayEnd, Layout, layout_maxima, pad_layout
from carpark_mj.mdp.terminations import PARKED_RULES, ParkedRule, find_rules
from carpark_mj.movers.scripted import Scripted
from carpark_mj.policy.runs import from_dict
from carpark_mj.reading import naming_file, parse_object, parse_yaml, read_text
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.suite.actors import (
    EACH,
    HEADING,
    SIZE,
    Actor,
    Pair,
    Pose,
    Spread,
    repeated,
    require,
    require_bays,
    varied,
)
from carpark_mj.suite.busy import EXTRA
from carpark_mj.suite.levels import LEVELS, CaseLevel, Cases, CaseStart
from carpark_mj.vehicle import preset

if TYPE_CHECKING:
    from carpark_mj.cli.settings.tables import ScenarioConfig

NAME = "scenario"
OWN = 4  # numbers that are drawn for the car
OWN_SETTINGS = {
    *("layout", "vehicle", "num_agents", "num_parked_cars", "movers", "fleet"),
    *("metrics", "episode.parked_rule", "episode.max_steps"),
}


@dataclasses.dataclass(frozen=True)
class Goal(CheckedConfig):
    """A bay that the lot gets for the scenario.

    Attributes:
        pose: centre [m] and heading of a car parked nose out [rad].
        size: length and width [m].
        end: which end of the car goes in first.
    """

    pose: Pose
    size: Pair = (BAY_LENGTH[0], BAY_WIDTH[0])
    end: Literal["either", "nose_first", "tail_first"] = "either"

    def __post_init__(self) -> None:
        super().__post_init__()
        require("the heading of pose", self.pose[2], HEADING)
        require("size", self.size, SIZE)


@dataclasses.dataclass(frozen=True)
class Tolerance(CheckedConfig):
    """When the car counts as parked.

    Attributes:
        distance: largest distance of the centres of car and bay [m].
        heading: largest angle to the bay's axis [rad].
        speed: highest speed [m/s].
        inside_lines: whether the car must be within the bay's lines.
    """

    distance: Positive = 0.2
    heading: Positive = 0.05
    speed: Positive = 0.05
    inside_lines: bool = False

    @property
    def rule(self) -> str:
        """The parked rule of these limits, registered by their numbers."""
        limits = dataclasses.asdict(self)
        words = (f"{name}-{value:.6g}" for name, value in limits.items() if value)
        name = "_".join(words).replace(".", "_")  # as names of rules must be
        if name not in PARKED_RULES:
            PARKED_RULES.register(name, ParkedRule(**limits))
        return name


@dataclasses.dataclass(frozen=True)
class Scenario(CheckedConfig):
    """A case with its repetitions; the module shows a file.

    Attributes:
        lot: name or file of a layout, or in Python a layout's config.
        vehicle: preset or data sheet of the car.
        start: pose of the centre of its footprint [m, m, rad].
        speed: at the start, forwards positive [m/s].
        goal: a bay, a row of `Layout.bay_pose`, or a bay of its own.
        parked: bays with parked cars, of the car's kind.
        rule: when the car counts as parked: a parked rule or its limits.
        seconds: of an episode.
        repetitions: how many.
        spread: of the repetitions' starts.
        movers: what moves.
        seed: of a random lot.
        settings: further settings of the environment, by path.
    """

    lot: str | LayoutConfig
    start: Pose
    goal: int | Goal
    vehicle: str = "compact"
    speed: float = 0.0
    parked: tuple[int, ...] = ()
    rule: str | Tolerance = "precise"
    seconds: Annotated[float, Bounds(gt=0.0, le=3600.0, unit="s")] = 60.0
    repetitions: Count = 1
    spread: Spread = dataclasses.field(default_factory=Spread)
    movers: tuple[Actor, ...] = ()
    seed: Natural = 0
    settings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        require("the heading of start", self.start[2], HEADING)
        find_rules(self.rule_name)
        car = preset(self.vehicle)
        speeds = Bounds(ge=-car.max_reverse_speed, le=car.max_speed, unit="m/s")
        require("speed", self.speed, speeds)
        layout = self.layout  # refuses unknown and random lots
        require_bays("goal", (self.goal_bay,), layout)
        bay, own = layout.bay_size[self.goal_bay], (car.length, car.width)
        if np.any(bay < np.array(own, np.float32)):
            raise ValueError(
                f"the car, {own[0]:g} m x {own[1]:g} m, is larger than the goal's bay, "
                f"{bay[0]:g} m x {bay[1]:g} m"
            )
        require_bays("parked", self.parked, layout)
        if self.goal_bay in self.parked or len({*self.parked}) < len(self.parked):
            raise ValueError(
                f"parked must be distinct bays other than the goal, not {self.parked}"
            )
        _ = self.scripts
        self._set(EnvConfig(layout="square"))

    @property
    def rule_name(self) -> str:
        """The parked rule by name."""
        return self.rule.rule if isinstance(self.rule, Tolerance) else self.rule

    @property
    def goal_bay(self) -> int:
        """The bay to park in; one of its own is the last."""
        return self.goal if isinstance(self.goal, int) else self.layout.num_bays - 1

    @functools.cached_property
    def layout(self) -> Layout:
        """The lot with the scenario's own bay, as numpy arrays."""
        # The first that `carpark_mj layouts --seed` draws.
        key = jax.random.fold_in(jax.random.key(self.seed), 0)
        layout = jax.device_get(make_layout(self.lot, key))
        return _with_bay(layout, self.goal) if isinstance(self.goal, Goal) else layout

    @functools.cached_property
    def scripts(self) -> tuple[Scripted, ...]:
        """The movers."""
        return tuple(actor.script(self.layout) for actor in self.movers)

    def env(self, env: EnvConfig) -> EnvConfig:
        """The scenario's environment, from that of a policy in the suite."""
        # A flag cannot name the lots of configs.
        env = self._set(dataclasses.replace(env, layout="square"))
        if self.parked and env.physics_config.contacts:
            raise ValueError(
                f"parked cars of a scenario need physics without contacts, not "
                f"{env.physics_config.back_end}"
            )
        steps = max(round(self.seconds / env.sim.ctrl_dt), 1)
        rule = {"parked_rule": self.rule_name, "max_steps": steps}
        extra = EXTRA if self.movers else ()
        return dataclasses.replace(
            env,
            layout=ScenarioLot(self),
            vehicle=self.vehicle,
            num_parked_cars=len(self.parked),
            fleet=FleetConfig(),
            movers=self.scripts,
            metrics=MetricsConfig(safety=True, extra=extra),
            episode=dataclasses.replace(env.episode, **rule),
        )

    def _set(self, env: EnvConfig) -> EnvConfig:
        if not self.settings:
            return env
        from carpark_mj.cli.driver import with_settings  # tyro is of an extra

        try:
            return with_settings(env, self.settings)
        except ValueError as error:
            raise ValueError(f"settings of the scenario: {error}") from None

    def pick(self, which: slice, level: str = NAME) -> Cases:
        """Repetitions that follow each other, under the name of their level."""
        number = np.arange(self.repetitions)[which]
        spread, chance = self.spread, self._chances[which].astype(np.float32)
        reach = np.array([spread.place, spread.place, spread.heading], np.float32)
        own, *others = np.split(chance, range(OWN, chance.shape[1], EACH), axis=1)
        options = ResetOptions(
            pose=jnp.asarray(self.start + own[:, :3] * reach)[:, None],
            speed=jnp.asarray(self.speed + own[:, 3:] * spread.speed),
            goal=jnp.full((len(number), 1), self.goal_bay, jnp.int32),
        )
        each = zip(self.scripts, self.movers, others, strict=True)
        movers = tuple(
            varied(script.init(jax.random.key(0), self.layout), actor.spread, rows)
            for script, actor, rows in each
        )
        keys = jax.vmap(jax.random.key)(number)
        same = np.array(self.parked, np.int32), self.layout
        parked, layouts = repeated(same, len(number))
        start = CaseStart(keys, options, movers, parked)
        return Cases(level, number, np.full(len(number), "repeated"), layouts, start)

    @property
    def _chances(self) -> np.ndarray:
        """(repetitions, numbers of each) uniform in [-1, 1); 0 in the first row."""
        shape = self.repetitions, OWN + EACH * len(self.movers)
        chances = np.random.default_rng(0).uniform(-1.0, 1.0, shape)
        chances[0] = 0.0
        return chances


def _with_bay(layout: Layout, goal: Goal) -> Layout:
    """A lot with one more bay, its last."""
    maxima, end = layout_maxima([layout]), BayEnd[goal.end.upper()]
    rows = {"bays": maxima.bays + 1, "bay_ends": maxima.bay_ends or bool(end)}
    padded = pad_layout(layout, dataclasses.replace(maxima, **rows))
    values = {"bay_pose": goal.pose, "bay_size": goal.size, "bay_mask": True}
    columns = {
        name: column.at[-1].set(jnp.asarray(value, column.dtype))
        for name, value in (values | {"bay_end": end}).items()
        if (column := getattr(padded, name)) is not None
    }
    return jax.device_get(dataclasses.replace(padded, **columns))


@dataclasses.dataclass(frozen=True)
class ScenarioLot(FixedLayoutConfig):
    """The lot of a scenario."""

    scenario: Scenario | None = None
    family: str = NAME

    @property
    def layout(self) -> Layout:
        """With the scenario's own bay."""
        assert self.scenario is not None
        return self.scenario.layout


# Entries that may be mappings: of what, or instead, and what they must be.
PARTS: dict[str, tuple[type, type, str]] = {
    "goal": (Goal, int, "a bay's number or {pose: [x, y, heading]}"),
    "rule": (Tolerance, str, "a parked rule or its limits, {distance: 0.1}"),
    "spread": (Spread, Spread, "deviations, {place: 0.1}"),
}


def read_scenario(path: Path) -> Scenario:
    """Reads a scenario, YAML or JSON; ValueError says where its fault is."""
    with naming_file(path):
        parse = parse_object if path.suffix == ".json" else parse_yaml
        return make_scenario(parse(read_text(path), "the scenario"))


def make_scenario(data: Mapping[str, Any]) -> Scenario:
    """The scenario of a file's mapping; ValueError of a fault in it."""
    try:
        return _made(dict(data))
    except ValueError as error:
        # YAML and JSON have lists, which become tuples.
        raise ValueError(str(error).replace("a tuple", "a list")) from None


def _made(found: dict[str, Any]) -> Scenario:
    movers, settings = found.pop("movers", []), found.pop("settings", {})
    if not isinstance(movers, list):
        raise ValueError(f"movers must be a list, each `- kind: ...`, not {movers!r}")
    if not isinstance(settings, dict):
        raise ValueError(
            f"settings must be names with values, `sim.steering_delay: 0.2`, not "
            f"{settings!r}"
        )
    actors = [_part(f"movers[{k}]", Actor, one) for k, one in enumerate(movers)]
    if not isinstance(found.get("lot", ""), str):
        raise ValueError(f"lot must be a layout's name or file, not {found['lot']!r}")
    for name, (kind, other, needed) in PARTS.items():
        if isinstance(value := found.get(name), dict):
            found[name] = _part(name, kind, value)
        elif name in found and not isinstance(value, kind | other):
            raise ValueError(f"{name} must be {needed}, not {value!r}")
    names = [str(name).replace("-", "_") for name in settings]
    if own := [x for x in names if OWN_SETTINGS & {x, x.partition(".")[0]}]:
        raise ValueError(f"settings must leave {own[0]} to the scenario's entries")
    words = tuple(f"{name}={value}" for name, value in settings.items())
    return from_dict(Scenario, found | {"movers": actors, "settings": words})


def _part(name: str, kind: Any, value: Any) -> Any:
    """A part of the scenario; its faults name it."""
    try:
        return from_dict(kind, value)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def scenario_level(path: str) -> CaseLevel:
    """The level of a scenario's file, `FILE` or `FILE:REPETITIONS`."""
    if not path:
        raise ValueError(f"level {NAME} needs a file, {NAME}:FILE")
    name, _, count = path.rpartition(":")
    file = Path(name if count.isdecimal() else path)
    state = file.absolute(), file.stat().st_mtime_ns if file.exists() else 0
    return _level(path, file, int(count) if count.isdecimal() else 0, state)


@functools.cache
def _level(
    path: str, file: Path, repetitions: int, _state: tuple[Path, int]
) -> CaseLevel:
    """The level of a file, made anew when the file is another or has changed."""
    scenario = read_scenario(file)
    if repetitions:
        scenario = dataclasses.replace(scenario, repetitions=repetitions)
    level, digest = f"{NAME}:{path}", hashlib.sha256(repr(scenario).encode())
    for leaf in jax.tree.leaves(scenario.layout):
        digest.update(np.ascontiguousarray(leaf).tobytes())
    pick, source = functools.partial(scenario.pick, level=level), Path(path).name
    data, rules = digest.hexdigest(), (scenario.rule_name, scenario.vehicle)
    numbers = range(scenario.repetitions)
    return CaseLevel(numbers, data, pick, scenario.env, f"Scenario {source}", *rules)


LEVELS.register(NAME, scenario_level)


def main(config: "ScenarioConfig") -> list[dict[str, Any]]:
    """Drives all repetitions by all policies and writes the suite's files."""
    from carpark_mj.cli.settings.tables import SuiteConfig  # tyro is of an extra
    from carpark_mj.suite import evaluation

    count = f":{config.repetitions}" * bool(config.repetitions)
    level = f"{NAME}:{config.file}{count}"
    scenario_level(config.file + count)  # refused before anything is compiled
    names = ("policies", "environment", "seeds", "videos", "out")
    same = {name: getattr(config, name) for name in names}
    return evaluation.main(SuiteConfig(levels=(level,), **same))

"""The environment's configuration."""

import copy
import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, TypeVar

from carpark_mj.config import checks
from carpark_mj.config.vehicles import with_parameters
from carpark_mj.layouts.base import LayoutChoice, LayoutConfig, require_layout
from carpark_mj.mdp.goals import GivingWayConfig, GoalConfig
from carpark_mj.mdp.metrics import MetricsConfig
from carpark_mj.mdp.rewards import ExtraTerms, RewardConfig
from carpark_mj.mdp.terminations import EpisodeConfig, find_rules
from carpark_mj.observations.fields import ENCODERS, ObservationConfig
from carpark_mj.observations.sensors import SensorConfig
from carpark_mj.obstacles import Mover, MoverChoice, make_movers
from carpark_mj.physics.config import (
    PhysicsChoice,
    PhysicsConfig,
    SimConfig,
    physics_config,
)
from carpark_mj.spawning.config import (
    FleetConfig,
    JitterConfig,
    RandomizationConfig,
    SpawnConfig,
)

Config = TypeVar("Config")


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """A parking environment.

    Attributes:
        layout: name of the lot: `square` (3.375 m x 5.625 m bays), `square_compact`
            (2.5 m x 5.0 m bays), a random family such as `street`, or any other of
            `LAYOUTS`; or a layout file (.json). A comma-separated list is a mixture.
            From Python also the config of a family, see `carpark_mj.layouts`.
        vehicle: a name in `carpark_mj.vehicle.VEHICLES`, or a vehicle file (.yaml,
            .json); the config then stores the parameters instead of the path.
        num_agents: number of agents, the cars that act.
        min_agents: smallest number of agents; a lot's number is drawn uniformly from
            here to `num_agents` when the lot begins. With fixed goals and `occupancy` a
            lot has at most one agent for every two bays. None = always `num_agents`.
        num_parked_cars: number of parked cars.
        occupancy: share of the lot's bays that hold a parked car, drawn from this range
            when the lot is reset; `num_parked_cars` is then the maximum. Agents' goals
            have priority: if they leave fewer bays, fewer cars are parked.
        fleet: presets from which cars are drawn instead of `vehicle`.
        jitter: variation of parked cars' poses in their bays, and of their sizes.
        movers: moving obstacles of the lot: names in `MOVERS`, or configs.
        physics: name of the back end. `mjx`: one MJX model per car, see `sim.stepper`;
            box tests find crashes. `scene`: the whole lot in one C MuJoCo world, whose
            contacts are crashes; slow. `bicycle`: kinematic cars without slip.
            `carpark_papers` adds `highway` and the grid worlds `grid`, `grid_coarse`,
            `grid_recorded` with integer actions. From Python also the config of a back
            end, a `PhysicsConfig`.
        sim: time steps and ground.
        goals: whether the environment or the agents choose the goals.
        giving_way: when agents should give up dynamic goals.
        spawn: where episodes start.
        episode: when episodes end.
        reward: reward weights.
        observation: its encoder; `carpark_mj.config.ENCODERS` has the named ones.
        randomization: parameters that differ between cars.
        sensors: noise, delay and drift of the observation.
        metrics: optional measurements.
    """

    layout: LayoutChoice = "square"
    vehicle: str = "compact"
    num_agents: checks.Count = 2
    min_agents: checks.Count | None = None
    num_parked_cars: checks.Natural = 16
    occupancy: Annotated[checks.Range, checks.Bounds(ge=0.0, le=1.0)] | None = None
    fleet: FleetConfig = dataclasses.field(default_factory=FleetConfig)
    jitter: JitterConfig = dataclasses.field(default_factory=JitterConfig)
    movers: tuple[MoverChoice, ...] = ()
    physics: PhysicsChoice = "mjx"
    sim: SimConfig = dataclasses.field(default_factory=SimConfig)
    goals: GoalConfig = dataclasses.field(default_factory=GoalConfig)
    giving_way: GivingWayConfig = dataclasses.field(default_factory=GivingWayConfig)
    spawn: SpawnConfig = dataclasses.field(default_factory=SpawnConfig)
    episode: EpisodeConfig = dataclasses.field(default_factory=EpisodeConfig)
    reward: RewardConfig = dataclasses.field(default_factory=RewardConfig)
    observation: ObservationConfig = dataclasses.field(
        default_factory=lambda: ENCODERS["continuous"]()
    )
    randomization: RandomizationConfig = dataclasses.field(
        default_factory=RandomizationConfig
    )
    sensors: SensorConfig = dataclasses.field(default_factory=SensorConfig)
    metrics: MetricsConfig = dataclasses.field(default_factory=MetricsConfig)

    def __post_init__(self) -> None:
        if not isinstance(self.layout, LayoutConfig | str):  # pyright: ignore
            raise ValueError(f"layout must be a name or a config, not {self.layout!r}")
        for name in self.layout.split(",") if isinstance(self.layout, str) else ():
            require_layout(name)
        movers, physics = tuple[Mover | str, ...], PhysicsConfig | str
        checks.require_types(
            self, layout=LayoutConfig | str, movers=movers, physics=physics
        )
        checks.require_bounds(self)
        object.__setattr__(self, "vehicle", with_parameters(self.vehicle))
        make_movers(self.movers)  # refuses unknown names
        for wrong, message in self._contradictions():
            if wrong:
                raise ValueError(message)
        if self.goals.dynamic:
            self.reward.goals.check()
        self.physics_config.check(self)
        self.observation.check(self)

    def _contradictions(self) -> Iterator[tuple[bool, str]]:
        """Combinations that would compute nonsense: whether one holds, and why not."""
        goals, spawn, episode = self.goals, self.spawn, self.episode
        physics, way = self.physics_config, self.giving_way
        most, least = self.num_agents, self.min_agents
        too_many = (least or 1) > most
        yield too_many, f"min_agents must be at most num_agents {most}, not {least}"
        out, full = goals.drive_out, bool(self.num_parked_cars or self.fleet.agents)
        yield out and goals.dynamic, "goals.drive_out needs goals.dynamic = False"
        yield out and any(spawn.ratios), "goals.drive_out needs all ratios of spawn = 0"
        yield out and full, "goals.drive_out needs num_parked_cars = 0 and no fleet"
        back_end = physics.back_end
        only_fixed = goals.dynamic or not physics.steers
        needs = "needs goals.dynamic = False and a physics whose cars steer; physics is"
        for setting, value in (
            ("spawn.reverse_ratio", spawn.reverse_ratio),
            ("spawn.misaligned_ratio", spawn.misaligned_ratio),
            ("reward.route or observation.route", self.follows_routes),
        ):
            yield bool(value) and only_fixed, f"{setting} {value} {needs} {back_end}"
        rules = find_rules(episode.parked_rule)
        yield (
            bool(spawn.misaligned_ratio) and not all(x.inside_lines for x in rules),
            f"spawn.misaligned_ratio {spawn.misaligned_ratio} needs a parked rule that "
            f"asks for the lines of the bay, as strict, not {episode.parked_rule}",
        )
        varies = self.randomization.is_on
        reach, sim = self.reward.reeds_shepp_reach, self.sim
        brakes = {x: getattr(sim, x) for x in ("emergency_brake", "manoeuvre_brake")}
        for wrong, what in (
            (
                varies and not physics.randomized,
                "randomization has no effect: leave it off",
            ),
            (reach and not physics.steers, f"reeds_shepp_reach must be 0, not {reach}"),
            *(
                (gap and not physics.actuated, f"{brake} must be 0, not {gap}")
                for brake, gap in brakes.items()
            ),
        ):
            yield bool(wrong), f"in {back_end} physics {what}"
        scale = episode.hitbox_scale
        yield (
            scale != 1.0 and physics.contacts,
            f"episode.hitbox_scale must be 1 in {back_end} physics, not {scale}",
        )
        observation = self.observation
        unaware = bool(self.fleet.agents) and not observation.own_car
        yield unaware, "fleet.agents needs observation.own_car = True"
        if way.scheme is None:
            return
        asks = f"giving_way.scheme {way.scheme!r}"
        yield not goals.dynamic, f"{asks} needs dynamic goals, goals.dynamic = True"
        wanted, found = way.global_information, observation.global_information
        what = f"needs observation.global_information = {wanted}, not {found}"
        yield found != wanted, f"{asks} {what}"
        local = (way.context or "").startswith("local")
        blind = local and not (observation.tracked.agents or observation.tracked.cars)
        yield blind, f"{asks} needs an observation that tracks at least 1 agent"

    @functools.cached_property
    def physics_config(self) -> PhysicsConfig:
        """The back end, with the traits that the task asks of it."""
        return physics_config(self.physics)

    @property
    def agent_counts(self) -> range:
        """How many agents a lot can have."""
        least = self.num_agents if self.min_agents is None else self.min_agents
        return range(least, self.num_agents + 1)

    @property
    def follows_routes(self) -> bool:
        """Whether the route along the lanes is rewarded or observed."""
        return self.observation.route or self.reward.route

    @functools.cached_property
    def varies(self) -> bool:
        """Whether the number, kinds, poses in bays or sizes of parked cars vary."""
        return self.fleet.is_on or self.jitter.is_on or self.occupancy is not None


def is_data(config: Any, path: str) -> bool:
    """Whether a setting, as `reward.park`, can have other values in one program.

    It must be a number, or a range: None and truth values decide what is computed, and
    so does a value that leaves something out, as noise of 0.
    """
    value = setting(config, path)
    parts = value if isinstance(value, tuple) else (value,)
    if any(isinstance(x, bool) or not isinstance(x, int | float) for x in parts):
        return False
    while not isinstance(config, ExtraTerms):
        name, _, rest = path.partition(".")
        if not rest:
            [field] = [x for x in dataclasses.fields(config) if x.name == name]
            return "data" in field.metadata and value != field.metadata["off"]
        config, path = getattr(config, name), rest
    return not config.is_fixed(path)


def setting(config: Any, path: str) -> Any:
    """The value of a setting by its path; `ValueError` if there is none."""
    if isinstance(config, ExtraTerms):
        return config[_require_setting(config, path)]
    name, dot, rest = path.partition(".")
    value = getattr(config, _require_setting(config, name))
    return setting(value, rest) if dot else value


def insert(config: Config, values: Mapping[str, Any]) -> Config:
    """A config with other values, which may be traced and are not checked, by path."""
    new = copy.copy(config)
    own = getattr(new, "__dict__", {})
    for computed in own.keys() - {*_names(new)}:
        del own[computed]  # properties that follow from the other values
    for path, value in values.items():
        if isinstance(new, ExtraTerms):
            new[_require_setting(new, path)] = value
            continue
        name, dot, rest = path.partition(".")
        _require_setting(new, name)
        value = insert(getattr(new, name), {rest: value}) if dot else value
        object.__setattr__(new, name, value)  # it is frozen
    return new


def _names(config: Any) -> list[str]:
    if isinstance(config, ExtraTerms):
        return list(config)
    is_config = dataclasses.is_dataclass(config)
    return [x.name for x in dataclasses.fields(config)] if is_config else []


def _require_setting(config: Any, name: str) -> str:
    """The name, which must be that of a setting of the config."""
    checks.require_name(f"{type(config).__name__} setting", name, _names(config))
    return name

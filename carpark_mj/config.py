"""Frozen, validated configuration of the environment: the only home of its defaults.

Impossible settings raise `ValueError` at construction, in one sentence.
"""

import dataclasses
import math
from typing import TYPE_CHECKING, ClassVar, Literal, get_args

# Layouts that need no more than a name; `carpark_mj.layouts` knows what they mean.
LayoutName = Literal[
    "angled",
    "compact",
    "dead_end",
    "garage_row",
    "lot",
    "mixture",
    "square",
    "street",
    "street_parallel",
    "tanner",
]
LAYOUT_FILES = (".json", ".csv")
Surface = Literal["dry", "wet", "ice"]
ParkedRule = Literal["tanner", "strict", "precise"]
RewardName = Literal["shaped", "tanner"]
TyresName = Literal["brush", "contact"]
PhysicsName = Literal["mjx", "scene"]
DistributionKind = Literal["uniform", "normal"]


CONTACT_SIM_DT = 0.004  # s


def _choose(name: str, value: str, literal: object) -> None:
    if value not in get_args(literal):
        raise ValueError(
            f"unknown {name} {value!r}; choose from {sorted(get_args(literal))}"
        )


def _at_least(config: object, minimum: float, *names: str) -> None:
    for name in names:
        value = getattr(config, name)
        if not (math.isfinite(value) and value >= minimum):
            raise ValueError(f"{name} must be at least {minimum}, not {value}")


def _positive(config: object, *names: str) -> None:
    for name in names:
        value = getattr(config, name)
        if not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} must be positive, not {value}")


def _ratio(config: object, *names: str) -> None:
    for name in names:
        value = getattr(config, name)
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{name} must lie in [0, 1], not {value}")


@dataclasses.dataclass(frozen=True)
class SimConfig:
    """Time steps and ground of the physics.

    Attributes:
        sim_dt: physics substep [s]; 0.01 for training, 0.005 as a reference.
        ctrl_dt: control period [s], a multiple of `sim_dt`.
        trace_dt: longest time between two collision checks within a step [s].
        grade_x: slope of the ground along world x, rise over run; 0.05 = 5 % uphill.
        grade_y: slope of the ground along world y.
        tyres: `brush`, or `contact`: MuJoCo's own contacts, for cross-checks; needs a
            `sim_dt` of at most 0.004 s.
        surface: how well tyres grip, `carpark_mj.vehicle.surfaces`.
    """

    sim_dt: float = 0.01
    ctrl_dt: float = 0.2
    trace_dt: float = 0.05
    grade_x: float = 0.0
    grade_y: float = 0.0
    tyres: TyresName = "brush"
    surface: Surface = "dry"

    def __post_init__(self) -> None:
        _choose("tyres", self.tyres, TyresName)
        _choose("surface", self.surface, Surface)
        _positive(self, "sim_dt", "ctrl_dt", "trace_dt")
        ratio = self.ctrl_dt / self.sim_dt
        if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
            raise ValueError(
                f"ctrl_dt must be a multiple of sim_dt, not {self.ctrl_dt} s with a "
                f"sim_dt of {self.sim_dt} s"
            )
        if self.trace_dt < self.sim_dt:
            raise ValueError(
                f"trace_dt must be at least sim_dt {self.sim_dt} s, not {self.trace_dt}"
            )
        if self.tyres == "contact" and self.sim_dt > CONTACT_SIM_DT:
            raise ValueError(
                f"contact tyres need a sim_dt of at most {CONTACT_SIM_DT} s, not "
                f"{self.sim_dt}: a locked wheel throws the car"
            )
        for name in ("grade_x", "grade_y"):
            if not abs(getattr(self, name)) < 1.0:
                raise ValueError(
                    f"{name} must lie within (-1, 1), not {getattr(self, name)}"
                )

    @property
    def num_substeps(self) -> int:
        """Physics substeps per control step."""
        return round(self.ctrl_dt / self.sim_dt)

    @property
    def num_traces(self) -> int:
        """Poses recorded per control step, the fewest that respect `trace_dt`."""
        longest = int(self.trace_dt / self.sim_dt + 1e-6)
        stride = max(k for k in range(1, longest + 1) if self.num_substeps % k == 0)
        return self.num_substeps // stride


@dataclasses.dataclass(frozen=True)
class SpawnConfig:
    """Where agents start an episode.

    Attributes:
        close_ratio: share of spawns next to the goal, the rest is random.
        close_distance: longest walk from the point nearest to the goal [m].
        min_distance: wanted distance to other agents' centres [m]; 7.38 m is Tanner's
            13.125 world units.
        num_candidates: poses drawn per spawn. The first that keeps `min_distance` is
            taken, or the one farthest from the other agents if none does.
    """

    close_ratio: float = 0.2
    close_distance: float = 5.625
    min_distance: float = 7.38
    num_candidates: int = 16

    def __post_init__(self) -> None:
        _ratio(self, "close_ratio")
        _at_least(self, 0.0, "close_distance", "min_distance")
        _at_least(self, 1, "num_candidates")


@dataclasses.dataclass(frozen=True)
class EpisodeConfig:
    """When an agent's episode ends.

    Attributes:
        parked_rule: what "parked" means. `tanner`: centre within 1.001 world units
            (0.563 m) of the bay's in x and y, at any speed and heading. `strict`:
            footprint within the bay's lines, heading within 5 deg of the bay's axis
            either way round, below 0.2 m/s. `precise`: centre within 0.2 m, heading
            within 3 deg, below 0.05 m/s.
        max_steps: control steps until an episode is cut off (truncated).
        respawn: an agent whose episode ends starts a new one at once; otherwise it
            stays where it is, on the brake, until the lot is reset.
    """

    parked_rule: ParkedRule = "strict"
    max_steps: int = 200
    respawn: bool = True

    def __post_init__(self) -> None:
        _choose("parked_rule", self.parked_rule, ParkedRule)
        _at_least(self, 1, "max_steps")


@dataclasses.dataclass(frozen=True)
class RewardConfig:
    """Weights of the reward terms of `carpark_mj.rewards`; a weight of 0 drops a term.

    Attributes:
        park: paid once when the agent parks.
        crash: taken once when it crashes.
        time: taken over a whole episode of `max_steps`, a share each step.
        progress: per metre gained towards the goal.
        alignment: per radian of misalignment with the goal's axis removed, fading
            with the distance to the goal.
        alignment_range: distance at which the alignment term has faded to 1/e [m].
        approach: over a whole episode, for each step that ends nearer to the goal;
            taken when it does not (Tanner's "move towards goal").
        smoothness: taken over a whole episode, times the steering change used.
        reverse: taken over a whole episode, for each step in reverse.
        closeness: taken over a whole episode, for each step times the share of
            `closeness_range` by which the nearest other agent is too close.
        closeness_range: clearance between agents at which closeness begins [m].
    """

    park: float = 4.0
    crash: float = 2.0
    time: float = 1.0
    progress: float = 0.2
    alignment: float = 0.5
    alignment_range: float = 4.0
    approach: float = 0.0
    smoothness: float = 0.0
    reverse: float = 0.0
    closeness: float = 10.0
    closeness_range: float = 3.0

    def __post_init__(self) -> None:
        names = [f.name for f in dataclasses.fields(self)]
        _at_least(self, 0.0, *names)
        _positive(self, "alignment_range", "closeness_range")


REWARDS: dict[str, RewardConfig] = {
    "shaped": RewardConfig(),
    # Table C.9 of Tanner 2022; potential-based terms off.
    "tanner": RewardConfig(
        park=1.0,
        crash=1.0,
        time=0.2,
        progress=0.0,
        alignment=0.0,
        approach=0.15,
        smoothness=0.05,
        reverse=0.1,
        closeness=0.0,
    ),
}


def reward_preset(name: str) -> RewardConfig:
    """Looks a named reward set up.

    Raises:
        ValueError: unknown name; the message lists the known ones.
    """
    _choose("reward", name, RewardName)
    return REWARDS[name]


@dataclasses.dataclass(frozen=True)
class ObservationConfig:
    """What an agent sees; the fields are listed in `carpark_mj.observations.fields`.

    Attributes:
        tracked_agents: nearest agents seen.
        tracked_parked_cars: nearest parked cars seen.
        rings: diameters [m] of the circles about the car in which walls are counted.
        ring_cap: largest count a ring reports.
    """

    tracked_agents: int = 2
    tracked_parked_cars: int = 2
    rings: tuple[float, ...] = (5.0, 6.2, 8.0)
    ring_cap: int = 2

    def __post_init__(self) -> None:
        _at_least(self, 0, "tracked_agents", "tracked_parked_cars")
        _at_least(self, 1, "ring_cap")
        if any(not d > 0 for d in self.rings):
            raise ValueError(f"rings must be positive diameters, not {self.rings}")
        if len({f"{d:g}" for d in self.rings}) < len(self.rings):  # the fields' names
            raise ValueError(f"rings must be different diameters, not {self.rings}")


class LayoutConfig:
    """Base of the configs in `carpark_mj.layouts`, one frozen dataclass per family.

    Attributes:
        family: name of the generator.
    """

    family: str

    @property
    def min_bays(self) -> int:
        """The fewest bays that any key gives."""
        raise NotImplementedError

    @property
    def is_random(self) -> bool:
        """Whether other keys give other lots."""
        return True


# tyro turns a union with dataclasses into subcommands; as a flag a layout is its name.
if TYPE_CHECKING:
    LayoutChoice = LayoutConfig | str
else:
    LayoutChoice = str


@dataclasses.dataclass(frozen=True)
class Distribution:
    """How a parameter varies between cars about its nominal value; off by default.

    With x = mean + width z, the value is nominal (1 + x), or nominal + x if absolute.

    Attributes:
        kind: of z: `uniform` in [-1, 1], or standard `normal` cut off at +- 2.
        width: 0 and a mean of 0 switch the distribution off.
        mean: shifts all cars alike.
        relative: x is a share of the nominal value, else in the parameter's unit.
    """

    kind: DistributionKind = "uniform"
    width: float = 0.0
    mean: float = 0.0
    relative: bool = True

    NORMAL_CUT: ClassVar[float] = 2.0

    def __post_init__(self) -> None:
        _choose("kind", self.kind, DistributionKind)
        _at_least(self, 0.0, "width")
        if not math.isfinite(self.mean):
            raise ValueError(f"mean must be finite, not {self.mean}")

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return self.width != 0.0 or self.mean != 0.0

    def bounds(self, nominal: float) -> tuple[float, float]:
        """Smallest and largest value that can be drawn."""
        reach = self.width * (self.NORMAL_CUT if self.kind == "normal" else 1.0)
        ends = (self.mean - reach, self.mean + reach)
        if self.relative:
            ends = (nominal * (1.0 + ends[0]), nominal * (1.0 + ends[1]))
        else:
            ends = (nominal + ends[0], nominal + ends[1])
        return min(ends), max(ends)


_ABSOLUTE = Distribution(relative=False)


@dataclasses.dataclass(frozen=True)
class RandomisationConfig:
    """What differs between cars, drawn anew at every spawn; all off by default.

    Attributes:
        mass: of the whole car [kg]; torques stay, so a loaded car is slower.
        cg_x: centre of gravity ahead of the rear axle [m].
        cg_height: centre of gravity above the ground [m].
        friction: factor on the tyres' friction; nominal 1.
        tyre_stiffness: factor on cornering and slip stiffness; nominal 1.
        brake_gain: factor on all brake torques; nominal 1.
        steering_offset: steered but not commanded [rad]; nominal 0, so absolute.
        steering_lag: [s].
    """

    mass: Distribution = Distribution()
    cg_x: Distribution = Distribution()
    cg_height: Distribution = Distribution()
    friction: Distribution = Distribution()
    tyre_stiffness: Distribution = Distribution()
    brake_gain: Distribution = Distribution()
    steering_offset: Distribution = _ABSOLUTE
    steering_lag: Distribution = _ABSOLUTE

    def __post_init__(self) -> None:
        if self.steering_offset.relative:
            raise ValueError("steering_offset must be absolute, its nominal value is 0")

    def distributions(self) -> dict[str, Distribution]:
        """By name, in a fixed order."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}

    @property
    def is_on(self) -> bool:
        """Whether anything varies."""
        return any(d.is_on for d in self.distributions().values())


@dataclasses.dataclass(frozen=True)
class SensorConfig:
    """Errors of what agents observe of the cars' motion; none by default.

    Attributes:
        position_noise: standard deviation of x and of y [m], white.
        heading_noise: of the yaw [rad], white.
        speed_noise: of the velocity, forward and left [m/s], white.
        delay_min: control steps by which a car's measurements are late, at least.
        delay_max: at most; drawn at every spawn.
    """

    position_noise: float = 0.0
    heading_noise: float = 0.0
    speed_noise: float = 0.0
    delay_min: int = 0
    delay_max: int = 0

    def __post_init__(self) -> None:
        _at_least(self, 0.0, "position_noise", "heading_noise", "speed_noise")
        _at_least(self, 0, "delay_min")
        _at_least(self, self.delay_min, "delay_max")

    @property
    def is_on(self) -> bool:
        """Whether what is observed differs from what is."""
        return self != SensorConfig()


@dataclasses.dataclass(frozen=True)
class EnvConfig:
    """A parking environment.

    Attributes:
        layout: the lot, by name: `tanner` (the study's square, 3.375 m x 5.625 m
            bays), `compact` (the same with 2.5 m x 5.0 m bays), or a family with its
            default settings: `street`, `street_parallel`, `angled`, `lot`,
            `garage_row`, `dead_end`, `mixture`. Or a layout file (.json, or a TPCAP
            case as .csv). From Python also the config of a family, see
            `carpark_mj.layouts`.
        vehicle: name of a preset in `carpark_mj.vehicle`.
        num_agents: cars that act.
        num_parked_cars: cars standing in bays.
        physics: back end. `mjx`: every car alone, crashes by box tests. `scene`: the
            whole lot in one C MuJoCo world, crashes by its contacts; slow.
        sim: time steps and ground.
        spawn: where episodes start.
        episode: when they end.
        reward: reward weights.
        observation: what an agent sees.
        randomisation: what differs between cars.
        sensors: errors of what an agent sees.
    """

    layout: LayoutChoice = "tanner"
    vehicle: str = "compact"
    num_agents: int = 2
    num_parked_cars: int = 16
    physics: PhysicsName = "mjx"
    sim: SimConfig = SimConfig()
    spawn: SpawnConfig = SpawnConfig()
    episode: EpisodeConfig = EpisodeConfig()
    reward: RewardConfig = RewardConfig()
    observation: ObservationConfig = ObservationConfig()
    randomisation: RandomisationConfig = RandomisationConfig()
    sensors: SensorConfig = SensorConfig()

    def __post_init__(self) -> None:
        if not isinstance(self.layout, LayoutConfig | str):  # pyright: ignore
            raise ValueError(f"layout must be a name or a config, not {self.layout!r}")
        if isinstance(self.layout, str) and not self.layout.endswith(LAYOUT_FILES):
            _choose("layout", self.layout, LayoutName)
        _choose("physics", self.physics, PhysicsName)
        _at_least(self, 1, "num_agents")
        _at_least(self, 0, "num_parked_cars")

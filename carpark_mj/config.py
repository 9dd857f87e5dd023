"""Frozen, validated configuration of the environment: the only home of its defaults.

Impossible settings raise `ValueError` at construction, in one sentence.
"""

import dataclasses
import math
from typing import TYPE_CHECKING, Literal, get_args

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
ParkedRule = Literal["tanner", "strict", "precise"]
RewardName = Literal["shaped", "tanner"]


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
    """

    sim_dt: float = 0.01
    ctrl_dt: float = 0.2
    trace_dt: float = 0.05
    grade_x: float = 0.0
    grade_y: float = 0.0

    def __post_init__(self) -> None:
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
        sim: time steps and ground.
        spawn: where episodes start.
        episode: when they end.
        reward: reward weights.
        observation: what an agent sees.
    """

    layout: LayoutChoice = "tanner"
    vehicle: str = "compact"
    num_agents: int = 2
    num_parked_cars: int = 16
    sim: SimConfig = SimConfig()
    spawn: SpawnConfig = SpawnConfig()
    episode: EpisodeConfig = EpisodeConfig()
    reward: RewardConfig = RewardConfig()
    observation: ObservationConfig = ObservationConfig()

    def __post_init__(self) -> None:
        if not isinstance(self.layout, LayoutConfig | str):  # pyright: ignore
            raise ValueError(f"layout must be a name or a config, not {self.layout!r}")
        if isinstance(self.layout, str) and not self.layout.endswith(LAYOUT_FILES):
            _choose("layout", self.layout, LayoutName)
        _at_least(self, 1, "num_agents")
        _at_least(self, 0, "num_parked_cars")

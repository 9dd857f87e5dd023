"""The observation vector of Tanner 2022's PPO (arXiv 2206.13338, section 3.2).

In order: own speed; the goal or, where agents choose it, every tracked bay; counts of
the rings, and of `RingConfig.history` steps before, the newest last; the tracked cars,
agents and parked cars in one list, the nearest first; where agents choose it, the own
goal. Every number is divided by how many values it can have, distances by the diagonal
of the study's world; angles count clockwise, bearings are rounded to the headings of
the grid. Absent entities are -1. It also works for physical cars, whose speeds and
headings are not rounded.

Where the study's text and its reference implementation disagree:

- goals: exploring and a goal that the observer does not track have values of their own,
  0 and the last (text); both are -1 in the implementation.
- a parked car's speed is that of standstill (text), not the number 0, which is the
  fastest reverse. Its goal is -1, as in the implementation.
- a tracked agent's goal is two numbers, bearing and distance as that agent observes
  them (implementation); `TannerShare.goal_headings` adds the third of the text.
- global information has the unit of the other distances (text); the implementation's is
  16 times too small. All agents with this goal count, the observer included.
- ring k has diameter k (text), and its count is capped for walls too.
- bays keep their places in the list while they are tracked (text), see
  `State.tracked_bays`; in the implementation places follow the distances.
- distances are not rounded (implementation).
"""

import dataclasses
import math
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp

from carpark_mj.config import (
    ENCODERS,
    WORLD_UNIT,
    EnvConfig,
    ObservationConfig,
    RingConfig,
)
from carpark_mj.config.checks import Bounds, CheckedConfig, Natural, Positive
from carpark_mj.geometry import nearest, norm, rotate, to_local
from carpark_mj.observations.ego import goal_code, rivals
from carpark_mj.observations.fields import (
    Field,
    ObservationInput,
    Tracked,
    repeated,
    repeated_values,
)
from carpark_mj.observations.ranges import (
    init_history,
    ring_counts,
    ring_fields,
    update_history,
)
from carpark_mj.observations.sensors import observed
from carpark_mj.observations.tracked import mark, other_agents
from carpark_mj.types import NO_BAY, ParkedCars, State
from carpark_papers.tanner.grid import (
    GridConfig,
    bearing_index,
    grid_scale,
    speed_level,
)


@dataclasses.dataclass(frozen=True)
class ViewConfig(CheckedConfig):
    """Where other cars and free bays are tracked; in the whole lot by default.

    Attributes:
        field_of_view: full angle of view about the own heading [deg].
        diameter: diameter of the circle about the car that is in view [m]; None = the
            whole lot.
    """

    field_of_view: Annotated[float, Bounds(gt=0.0, le=360.0, unit="deg")] = 360.0
    diameter: Positive | None = None

    @property
    def is_limited(self) -> bool:
        """Whether anything in the lot can be out of view."""
        return self != ViewConfig()


def in_view(config: ViewConfig, own_pose: jax.Array, xy: jax.Array) -> jax.Array:
    """Whether points lie in the field of view and tracking circle of each agent.

    Points are (n, 2), or (num_agents, n, 2) of each agent's own; (num_agents, n) bool.
    """
    offset = xy - own_pose[:, None, :2]
    seen = jnp.ones(offset.shape[:-1], bool)
    if config.diameter is not None:
        seen = seen & (norm(offset) <= config.diameter / 2)
    if config.field_of_view < 360.0:
        local = rotate(offset, -own_pose[:, None, 2])
        bearing = jnp.arctan2(local[..., 1], local[..., 0])
        seen = seen & (jnp.abs(bearing) <= jnp.radians(config.field_of_view / 2))
    return seen


def track_cars(
    count: int,
    view: ViewConfig,
    own_pose: jax.Array,
    parked_cars: ParkedCars,
    present: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """The nearest among the other agents and parked cars together.

    Returns indices and presence (num_agents, count), see `geometry.nearest`; indices
    count the agents first, then the parked cars. `present` is `State.present`.
    """
    own_xy, num_agents = own_pose[:, :2], own_pose.shape[0]
    others, parked = other_agents(num_agents, present), parked_cars.present
    parked = jnp.broadcast_to(parked, (num_agents, *parked.shape))
    xy = jnp.concatenate([own_xy, parked_cars.pose_w[:, :2]])
    mask = jnp.concatenate([others, parked], axis=1)
    return nearest(own_xy, xy, mask & in_view(view, own_pose, xy), count)


BayPart = Literal["heading", "distance", "bearing"]
BAY_PARTS: tuple[BayPart, ...] = ("heading", "distance", "bearing")

DIAGONAL = 74 * 2**0.5 * WORLD_UNIT  # m, of the study's world of 74 x 74 world units

# Parts of a bay and of a car by name: highest value (-1 = absent) and meaning.
_PARTS = {
    "heading": (1.0, "heading minus own, clockwise [360 deg]"),
    "distance": (1.5, "to its centre [diagonal]"),
    "bearing": (1.0, "of its centre, clockwise from ahead, rounded [360 deg]"),
    "nearest_agent": (1.5, "from it to the nearest of all agents [diagonal]"),
    "claim": (1.5, "from it to the nearest agent with this goal [diagonal]"),
    "goal_heading": (1.0, "its goal's heading minus its own, clockwise [360 deg]"),
    "goal_distance": (1.5, "from it to its goal [diagonal]"),
    "goal_bearing": (1.0, "of its goal, clockwise from ahead of it [360 deg]"),
    "goal": (1.0, "its goal [values]: 0 exploring, the own bays, one not tracked"),
    "speed": (1.5, "its speed from fastest reverse [levels]"),
}


@dataclasses.dataclass(frozen=True)
class TannerShare(CheckedConfig):
    """What agents observe of the other agents they track, in addition to their poses.

    Attributes:
        speeds: observe the speeds of tracked agents.
        goals: observe the goals of tracked agents: bearings and distances of fixed
            goals, and which of the observer's tracked bays a dynamic goal is.
        goal_headings: also observe the headings of their goals; fixed goals only.
    """

    speeds: bool = True
    goals: bool = True
    goal_headings: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.goal_headings and not self.goals:
            raise ValueError("share.goal_headings needs share.goals")


@dataclasses.dataclass(frozen=True)
class TannerObservation(ObservationConfig):
    """The vector of the study's PPO; the defaults follow tables C.9 and C.10.

    Attributes:
        tracked_cars: number of nearest cars observed, agents and parked cars in one
            list (n_track); where there are fewer, the list is padded with -1.
        bay_parts: what is observed of the goal, or of every tracked bay.
        view: region in which cars and free bays are tracked.
        share: what is observed of tracked agents in addition to their poses.
        global_information: observe, for the goal or every tracked bay, the distances to
            the nearest agent and to the nearest agent that has it as its goal.
        rings: circles that count objects.
        encoding: name of the encoder; as a flag it chooses another.
    """

    tracked_cars: Natural = 1
    bay_parts: tuple[BayPart, ...] = BAY_PARTS
    view: ViewConfig = dataclasses.field(default_factory=ViewConfig)
    share: TannerShare = dataclasses.field(default_factory=TannerShare)
    global_information: bool = False
    rings: RingConfig = dataclasses.field(
        default_factory=lambda: RingConfig((11 * WORLD_UNIT,), cap=1)
    )
    encoding: str = "tanner"

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(set(self.bay_parts)) < len(self.bay_parts):
            raise ValueError(f"bay_parts must be different, not {self.bay_parts}")

    def check(self, env: EnvConfig) -> None:
        """Refuses headings of goals that agents choose."""
        if env.goals.dynamic and self.share.goal_headings:
            raise ValueError("observation.share.goal_headings needs fixed goals")

    def fields(self, env: EnvConfig) -> list[Field]:
        """See the head of this module."""
        num_tracked_bays = env.goals.num_tracked_bays if env.goals.dynamic else 0

        def parts(names: list[str], prefix: str = "", **traits: Any) -> list[Field]:
            traits["mirror"] = (0,)  # clockwise shares of a turn have no image
            return [
                Field(prefix + name, 1, -1.0, *_PARTS[name], **_scale(name), **traits)
                for name in names
            ]

        # Cars with other limits than the grid's may leave its range of speeds by a
        # little.
        meaning = "own speed from fastest reverse [levels]"
        fields = [Field("speed", 1, -0.5, 1.5, meaning, **_scale("speed"))]
        if num_tracked_bays:
            fields += repeated("bay", num_tracked_bays, parts(_bay_parts(self)))
        else:
            fields += parts(_bay_parts(self), "goal_", reveals_goal=True)
        circle = f"the circle about it [{self.rings.cap + 1}]"
        fields += ring_fields(self.rings, 1.0, circle)
        car = parts(_car_parts(self, num_tracked_bays > 0))
        fields += repeated("car", self.tracked_cars, car)
        if num_tracked_bays:
            meaning = "own goal [values]: 0 exploring, then the own bays"
            fields.append(Field("goal_choice", 1, 0.0, 1.0, meaning, reveals_goal=True))
        return fields

    def values(self, env: EnvConfig, state: State) -> dict[str, jax.Array]:
        """Values (num_agents, 1) of the fields by name."""
        grid = grid_scale(env)
        layout, goal, motion = state.layout, state.goal, observed(state)
        level = speed_level(grid, env.sim.ctrl_dt, motion.speed) + grid.max_reverse
        values = {"speed": (level / grid.num_levels)[:, None]}

        tracked, bays = state.tracked_bays, goal[:, None]
        if tracked is not None:
            seen = in_view(self.view, motion.pose_w, layout.bay_pose[tracked, :2])
            bays = jnp.where(seen, tracked, NO_BAY)
            own = goal_code(goal[:, None], tracked)
            values["goal_choice"] = own / (tracked.shape[1] + 1)
        parts = _describe(grid, motion.pose_w[:, None], layout.parked_pose[bays])
        nearest, claim = rivals(layout, motion.xy, goal, bays)
        parts["nearest_agent"] = nearest / DIAGONAL
        parts["claim"] = jnp.where(jnp.isinf(claim), -1.0, claim / DIAGONAL)
        described = {
            name: jnp.where(bays != NO_BAY, parts[name], -1.0)[..., None]
            for name in _bay_parts(self)
        }
        if tracked is not None:
            values |= repeated_values("bay", described)
        else:
            values |= {f"goal_{name}": value[:, 0] for name, value in described.items()}

        counts = ring_counts(self.rings, ObservationInput.of(state))
        values |= {name: count / (self.rings.cap + 1) for name, count in counts.items()}
        if self.tracked_cars:
            cars = _describe_cars(self, grid, state, level, bays)
            values |= repeated_values("car", cars)
        return values

    @property
    def tracked(self) -> Tracked:
        """Cars of either kind."""
        return Tracked(cars=self.tracked_cars)

    @property
    def circles(self) -> tuple[float, ...]:
        """Diameters of the rings."""
        return self.rings.diameters

    def tracks_agents(self, state: State) -> jax.Array | None:
        """Tracked agents among the nearest cars."""
        num_agents = state.goal.shape[0]
        return self._tracks(state)[:, :num_agents] if self.tracked_cars else None

    def tracks_parked_cars(self, state: State) -> jax.Array | None:
        """Tracked parked cars among the nearest cars."""
        num_agents = state.goal.shape[0]
        return self._tracks(state)[:, num_agents:] if self.tracked_cars else None

    def _tracks(self, state: State) -> jax.Array:
        """(num_agents, num_agents + num_parked_cars) bool."""
        tracked = track_cars(
            self.tracked_cars,
            self.view,
            observed(state).pose_w,
            state.parked_cars,
            state.present,
        )
        return mark(*tracked, state.goal.shape[0] + state.parked_cars.bay.shape[0])

    def bays_in_view(self, state: State) -> jax.Array | None:
        """By where they truly are."""
        if not self.view.is_limited:
            return None
        return in_view(self.view, state.motion.pose_w, state.layout.bay_pose[:, :2])

    def init_memory(self, env: EnvConfig) -> dict[str, jax.Array]:
        """What the rings counted before: nothing."""
        return init_history(self.rings, env.num_agents)

    def remember(self, state: State) -> dict[str, jax.Array]:
        """What the rings have counted."""
        return update_history(self.rings, state)


def _scale(part: str) -> dict[str, Any]:
    """Scale of a part without bounds of its own, see `Field`."""
    if part == "speed":
        return {"speed": math.inf}
    far = part.endswith("distance") or part in ("nearest_agent", "claim")
    return {"metres": DIAGONAL} if far else {}


def _bay_parts(config: TannerObservation) -> list[str]:
    """What is observed of the goal or of a tracked bay, in order."""
    parts = [part for part in BAY_PARTS if part in config.bay_parts]
    return [*parts, "nearest_agent", "claim"] if config.global_information else parts


def _car_parts(config: TannerObservation, dynamic: bool) -> list[str]:
    """What is observed of a tracked car, in order."""
    share, parts = config.share, ["distance", "bearing", "heading"]
    if share.goals:
        parts += ["goal"] if dynamic else ["goal_bearing", "goal_distance"]
    if share.goal_headings:
        parts.append("goal_heading")
    return [*parts, "speed"] if share.speeds else parts


def _describe_cars(
    config: TannerObservation,
    grid: GridConfig,
    state: State,
    level: jax.Array,
    bays: jax.Array,
) -> dict[str, jax.Array]:
    """Parts of the tracked cars, (num_agents, tracked_cars, 1) each.

    `level` (num_agents,) are the agents' speeds from the fastest reverse, `bays`
    (num_agents, count) what observers track and see, unused while goals are fixed.
    """
    goal, parked_cars, pose = state.goal, state.parked_cars, observed(state).pose_w
    index, present = track_cars(
        config.tracked_cars, config.view, pose, parked_cars, state.present
    )
    everybody = jnp.concatenate([pose, parked_cars.pose_w])
    parts = _describe(grid, pose[:, None], everybody[index])
    none = jnp.zeros(parked_cars.bay.shape[0])
    level = jnp.concatenate([level, none + grid.max_reverse])
    parts["speed"] = level[index] / grid.num_levels
    if state.tracked_bays is None:
        theirs = _describe(grid, pose, state.layout.parked_pose[goal])
        for name, value in theirs.items():
            parts[f"goal_{name}"] = jnp.concatenate([value, none - 1.0])[index]
    else:
        no_goal = jnp.full(none.shape, NO_BAY, goal.dtype)
        code = goal_code(jnp.concatenate([goal, no_goal])[index], bays)
        known = code / (bays.shape[1] + 2)
        parts["goal"] = jnp.where(index < goal.shape[0], known, -1.0)
    return {
        name: jnp.where(present, parts[name], -1.0)[..., None]
        for name in _car_parts(config, state.tracked_bays is not None)
    }


def _describe(
    grid: GridConfig, own_pose: jax.Array, pose: jax.Array
) -> dict[str, jax.Array]:
    """Poses (..., 3) as an observer sees them: `heading`, `distance`, `bearing`."""
    local = to_local(own_pose, pose)
    # Equal headings must not become almost a full turn by rounding: within 0.04 deg of
    # it they are slightly negative instead.
    slack = 1e-4
    turn = jnp.mod(-local[..., 2] / (2 * jnp.pi) + slack, 1.0) - slack
    return {
        "heading": turn,
        "distance": norm(local[..., :2]) / DIAGONAL,
        "bearing": bearing_index(grid, local) / grid.headings,
    }


ENCODERS.register("tanner", TannerObservation)

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
  them (implementation); `ShareConfig.goal_headings` adds the third of the text.
- global information has the unit of the other distances (text); the implementation's is
  16 times too small. All agents with this goal count, the observer included.
- ring k has diameter k (text), and its count is capped for walls too.
- bays keep their places in the list while they are tracked (text), see
  `State.tracked_bays`; in the implementation places follow the distances.
- distances are not rounded (implementation).
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import WORLD_UNIT, TannerObservation
from carpark_mj.config.observations import BAY_PARTS
from carpark_mj.geometry import norm, to_local
from carpark_mj.observations.bay_fields import goal_code, rivals
from carpark_mj.observations.fields import Field, repeated, repeated_values
from carpark_mj.observations.rings import ring_counts, ring_fields
from carpark_mj.observations.sensors import observed
from carpark_mj.observations.tracking import in_view, track_cars
from carpark_mj.studies.tanner.grid_config import GridConfig
from carpark_mj.types import NO_BAY, State

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


def tanner_fields(config: TannerObservation, num_tracked_bays: int) -> list[Field]:
    """Lists the fields in order; `num_tracked_bays` is 0 while goals are fixed."""

    def parts(names: list[str], prefix: str = "") -> list[Field]:
        return [Field(prefix + name, 1, -1.0, *_PARTS[name]) for name in names]

    # Cars with other limits than the grid's may leave its range of speeds by a little.
    fields = [Field("speed", 1, -0.5, 1.5, "own speed from fastest reverse [levels]")]
    if num_tracked_bays:
        fields += repeated("bay", num_tracked_bays, parts(_bay_parts(config)))
    else:
        fields += parts(_bay_parts(config), "goal_")
    circle = f"the circle about it [{config.rings.cap + 1}]"
    fields += ring_fields(config.rings, 1.0, circle)
    car = parts(_car_parts(config, num_tracked_bays > 0))
    fields += repeated("car", config.tracked_cars, car)
    if num_tracked_bays:
        meaning = "own goal [values]: 0 exploring, then the own bays"
        fields.append(Field("goal_choice", 1, 0.0, 1.0, meaning))
    return fields


def tanner_values(
    config: TannerObservation, grid: GridConfig, ctrl_dt: float, state: State
) -> dict[str, jax.Array]:
    """Values (num_agents, 1) of the fields by name.

    Args:
        config: what is observed.
        grid: granularities.
        ctrl_dt: control period [s].
        state: of the lot.
    """
    layout, goal, motion = state.layout, state.goal, observed(state)
    level = speed_level(grid, ctrl_dt, motion.speed) + grid.max_reverse
    values = {"speed": (level / grid.num_levels)[:, None]}

    tracked, bays = state.tracked_bays, goal[:, None]
    if tracked is not None:
        seen = in_view(config.view, motion.pose_w, layout.bay_pose[tracked, :2])
        bays = jnp.where(seen, tracked, NO_BAY)
        own = goal_code(goal[:, None], tracked)
        values["goal_choice"] = own / (tracked.shape[1] + 1)
    parts = _describe(grid, motion.pose_w[:, None], layout.parked_pose[bays])
    nearest, claim = rivals(layout, motion.xy, goal, bays)
    parts["nearest_agent"] = nearest / DIAGONAL
    parts["claim"] = jnp.where(jnp.isinf(claim), -1.0, claim / DIAGONAL)
    described = {
        name: jnp.where(bays != NO_BAY, parts[name], -1.0)[..., None]
        for name in _bay_parts(config)
    }
    if tracked is not None:
        values |= repeated_values("bay", described)
    else:
        values |= {f"goal_{name}": value[:, 0] for name, value in described.items()}

    counts = ring_counts(config.rings, state)
    values |= {name: count / (config.rings.cap + 1) for name, count in counts.items()}
    if config.tracked_cars:
        cars = _describe_cars(config, grid, state, level, bays)
        values |= repeated_values("car", cars)
    return values


def speed_level(grid: GridConfig, ctrl_dt: float, speed: jax.Array) -> jax.Array:
    """Speeds [m/s] in levels of the grid, forwards positive."""
    return speed / (grid.speed_step * grid.point_size / ctrl_dt)


def bearing_index(grid: GridConfig, local: jax.Array) -> jax.Array:
    """Bearings of poses (..., 3) in the observer's frame to the nearest heading.

    Returns:
        (...) integers in [0, headings), clockwise from ahead.
    """
    clockwise = -jnp.arctan2(local[..., 1], local[..., 0])
    return jnp.mod(jnp.round(clockwise * grid.headings / (2 * jnp.pi)), grid.headings)


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

    Args:
        config: what is observed.
        grid: granularities.
        state: of the lot.
        level: (num_agents,) the agents' speeds from the fastest reverse [levels].
        bays: (num_agents, count) the bays that the observers track and see; unused
            while goals are fixed.
    """
    goal, parked_cars, pose = state.goal, state.parked_cars, observed(state).pose_w
    index, present = track_cars(config, pose, parked_cars, state.present)
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

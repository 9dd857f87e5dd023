"""The observation vector of Tanner 2022's PPO (arXiv 2206.13338, section 3.2).

In order: own speed; the goal or, where agents choose it, every tracked bay; counts of
the rings, and of `ring_history` steps before, the newest last; the tracked cars, agents
and parked cars in one list, the nearest first; where agents choose it, the own goal.
Every number is divided by how many values it can have, distances by the diagonal of his
world; angles count clockwise, bearings are rounded to the headings of the grid. What
there is not is -1. All of it works for physical cars too, whose speeds and headings are
not rounded.

Where his text and his program disagree:

- goals: exploring and a goal that the observer does not track have values of their own,
  0 and the last (text); both are -1 in the program.
- a parked car's speed is that of a car that stands (text), not the number 0, which is
  the fastest reverse. Its goal is -1, as in the program.
- a tracked agent's goal is two numbers, bearing and distance as that agent sees them
  (program); `share_goal_heading` adds the third of the text.
- global information has the unit of the other distances (text); the program's is 16
  times too small. Whoever heads for the bay counts, the observer too.
- ring k has diameter k (text), and its count is capped for walls too.
- bays keep their places in the list while they are tracked (text): `State.spaces`; in
  the program places follow the distances.
- distances are not rounded (program).
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import WORLD_UNIT, GridConfig, ObservationConfig
from carpark_mj.geometry import to_local
from carpark_mj.layouts.types import Layout
from carpark_mj.observations.fields import make_fields
from carpark_mj.observations.rings import count_rings, ring_counts
from carpark_mj.observations.spaces import goal_code, rivals
from carpark_mj.observations.tracking import in_view, track_cars
from carpark_mj.types import Motion

DIAGONAL = 74 * 2**0.5 * WORLD_UNIT  # m, of his world of 74 x 74 world units


def speed_level(grid: GridConfig, ctrl_dt: float, speed: jax.Array) -> jax.Array:
    """Speeds [m/s] in levels of the grid, forwards positive."""
    return speed / (grid.speed_step * grid.point_size / ctrl_dt)


def bearing_index(grid: GridConfig, local: jax.Array) -> jax.Array:
    """Bearings of poses (..., 3) in the observer's frame to the nearest heading.

    Returns:
        (...) whole numbers in [0, headings), clockwise from ahead.
    """
    clockwise = -jnp.arctan2(local[..., 1], local[..., 0])
    return jnp.mod(jnp.round(clockwise * grid.headings / (2 * jnp.pi)), grid.headings)


def observe_tanner(
    config: ObservationConfig,
    grid: GridConfig,
    ctrl_dt: float,
    layout: Layout,
    vehicle: Motion,
    goal: jax.Array,
    parked_pose: jax.Array,
    parked_size: jax.Array,
    parked_present: jax.Array | None = None,
    spaces: jax.Array | None = None,
    ring_history: jax.Array | None = None,
) -> jax.Array:
    """Observations of all agents of a lot.

    Args:
        config: what is observed.
        grid: granularities.
        ctrl_dt: control period [s].
        layout: the lot.
        vehicle: the agents (num_agents,).
        goal: (num_agents,) bay indices; `layout.num_bays` = exploring.
        parked_pose: (num_parked_cars, 3).
        parked_size: (num_parked_cars, 2) [m].
        parked_present: (num_parked_cars,) bool, cars that exist; None = all.
        spaces: (num_agents, num_spaces) bays tracked, `layout.num_bays` = none; None
            while goals are fixed.
        ring_history: see `rings.init_history`.

    Returns:
        (num_agents, observation_size) float32, the fields of `make_fields`.
    """
    num_agents, num_bays = goal.shape[0], layout.num_bays
    num_spaces = 0 if spaces is None else spaces.shape[1]
    pose, xy = vehicle.pose_w, vehicle.pose_w[:, :2]
    parked = jnp.zeros(parked_pose.shape[0])
    level = speed_level(grid, ctrl_dt, vehicle.speed) + grid.max_reverse
    values = {"speed": level / grid.num_levels}

    bays = goal[:, None]
    if spaces is not None:
        seen = in_view(config, pose, layout.bay_pose[spaces, :2])
        bays = jnp.where(seen, spaces, num_bays)
    parts = _describe(grid, pose[:, None], layout.bay_pose[bays])
    parts["nearest_agent"], claim = rivals(layout, xy, goal, bays)
    parts["nearest_agent"] = parts["nearest_agent"] / DIAGONAL
    parts["claim"] = jnp.where(jnp.isinf(claim), -1.0, claim / DIAGONAL)
    for k in range(bays.shape[1]):
        name = f"space_{k}" if num_spaces else "goal"
        for part, value in parts.items():
            values[f"{name}_{part}"] = jnp.where(
                bays[:, k] < num_bays, value[:, k], -1.0
            )

    if config.rings:
        now = count_rings(config, layout, vehicle, parked_pose, parked_size)
        counts = ring_counts(config, now, ring_history)
        scale = config.ring_cap + 1
        values |= {name: count[:, 0] / scale for name, count in counts.items()}

    if config.tracked_cars:
        index, present = track_cars(config, pose, parked_pose[:, :2], parked_present)
        everybody = jnp.concatenate([pose, parked_pose])
        cars = _describe(grid, pose[:, None], everybody[index])
        level = jnp.concatenate([level, parked + grid.max_reverse])
        cars["speed"] = level[index] / grid.num_levels
        if spaces is None:
            theirs = _describe(grid, pose, layout.bay_pose[goal])
            for part, value in theirs.items():
                cars[f"goal_{part}"] = jnp.concatenate([value, parked - 1.0])[index]
        else:
            nowhere = jnp.full(parked.shape, num_bays, goal.dtype)
            code = goal_code(jnp.concatenate([goal, nowhere])[index], bays, num_bays)
            known = code / (num_spaces + 2)
            cars["goal"] = jnp.where(index < num_agents, known, -1.0)
        for k in range(config.tracked_cars):
            for part, value in cars.items():
                values[f"car_{k}_{part}"] = jnp.where(present, value, -1.0)[:, k]
    if spaces is not None:
        own = goal_code(goal[:, None], spaces, num_bays)[:, 0]
        values["goal_choice"] = own / (num_spaces + 1)

    fields = make_fields(config, grid, num_spaces)
    return jnp.stack([values[field.name] for field in fields], -1).astype(jnp.float32)


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
        "distance": jnp.linalg.norm(local[..., :2], axis=-1) / DIAGONAL,
        "bearing": bearing_index(grid, local) / grid.headings,
    }

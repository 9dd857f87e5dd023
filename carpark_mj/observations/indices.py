"""The observation of Tanner 2022's Q-learning: a few integers that index a table.

Own level of speed, counted from the fastest reverse; the bearing of the goal's centre,
clockwise from the own heading, to the nearest of the grid's headings; and for every
ring how many objects touch it, capped, now and `RingConfig.history` steps before. The
k-th ring has the k-th diameter: the reference implementation gives it the one before.
"""

import jax
import jax.numpy as jnp

from carpark_mj.config import EnvConfig, IndexObservation
from carpark_mj.geometry import to_local
from carpark_mj.observations.fields import Field
from carpark_mj.observations.rings import ring_counts, ring_fields
from carpark_mj.observations.sensors import observed
from carpark_mj.observations.tanner import bearing_index, speed_level
from carpark_mj.studies.tanner.grid_config import GridConfig, grid_scale
from carpark_mj.types import State


def index_fields(config: IndexObservation, grid: GridConfig) -> list[Field]:
    """Lists the fields in order."""
    return [
        Field("level", 1, 0.0, grid.num_levels - 1, "own speed from fastest reverse"),
        Field(
            "bearing", 1, 0.0, grid.headings - 1, "of the goal, clockwise from ahead"
        ),
        *ring_fields(config.rings, config.rings.cap, "the circle about the car"),
    ]


def index_values(
    config: IndexObservation, grid: GridConfig, ctrl_dt: float, state: State
) -> dict[str, jax.Array]:
    """Integers (num_agents, 1) by the fields' names.

    Args:
        config: rings.
        grid: granularities.
        ctrl_dt: control period [s].
        state: of the lot; goals are fixed.
    """
    motion = observed(state)
    level = jnp.round(speed_level(grid, ctrl_dt, motion.speed)) + grid.max_reverse
    goal_pose = state.layout.parked_pose[state.goal]
    bearing = bearing_index(grid, to_local(motion.pose_w, goal_pose))
    values = {"level": level[:, None], "bearing": bearing[:, None]}
    return values | ring_counts(config.rings, state)


def cardinalities(config: EnvConfig) -> tuple[int, ...]:
    """How many values each number of the observation can have.

    Raises:
        ValueError: the encoding is not `indices`.
    """
    observation = config.observation
    if not isinstance(observation, IndexObservation):
        raise ValueError(
            "a table needs observation.encoding 'indices', not "
            f"{observation.encoding!r}"
        )
    fields = index_fields(observation, grid_scale(config))
    return tuple(int(field.high) + 1 for field in fields)

"""The observation of Tanner 2022's Q-learning: a few integers that index a table.

Own level of speed, counted from the fastest reverse; the bearing of the goal's centre,
clockwise from the own heading, to the nearest of the grid's headings; and for every
ring how many objects touch it, capped, now and `RingConfig.history` steps before. The
k-th ring has the k-th diameter: the reference implementation gives it the one before.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp

from carpark_mj.config import ENCODERS, EnvConfig, ObservationConfig, RingConfig
from carpark_mj.geometry import to_local
from carpark_mj.observations.fields import Field, ObservationInput
from carpark_mj.observations.ranges import (
    init_history,
    ring_counts,
    ring_fields,
    update_history,
)
from carpark_mj.observations.sensors import observed
from carpark_mj.types import State
from carpark_papers.tanner.grid import (
    GridConfig,
    bearing_index,
    grid_scale,
    speed_level,
)


@dataclasses.dataclass(frozen=True)
class IndexObservation(ObservationConfig):
    """Integers that index a table. Goals must be fixed.

    Attributes:
        rings: circles that count objects.
        encoding: name of the encoder; as a flag it chooses another.
    """

    rings: RingConfig = dataclasses.field(default_factory=RingConfig)
    encoding: str = "indices"

    def check(self, env: EnvConfig) -> None:
        """Refuses cars that are not on the grid, and goals that agents choose."""
        physics = env.physics_config
        if not isinstance(physics, GridConfig):
            raise ValueError(
                "observation.encoding 'indices' needs grid physics, not "
                f"{physics.back_end}"
            )
        if env.goals.dynamic:
            raise ValueError(
                "observation.encoding 'indices' needs fixed goals, not dynamic ones"
            )

    def fields(self, env: EnvConfig) -> list[Field]:
        """See the head of this module."""
        grid, rings = grid_scale(env), self.rings
        top, last = grid.num_levels - 1, grid.headings - 1
        fields = [
            Field(
                "level", 1, 0.0, top, "own speed from fastest reverse", speed=math.inf
            ),
            Field(
                "bearing",
                1,
                0.0,
                last,
                "of the goal, clockwise from ahead",
                reveals_goal=True,
                mirror=(0,),
            ),
            *ring_fields(rings, rings.cap, "the circle about the car"),
        ]
        return [dataclasses.replace(field, is_whole=True) for field in fields]

    def values(self, env: EnvConfig, state: State) -> dict[str, jax.Array]:
        """Integers (num_agents, 1) by the fields' names."""
        grid, motion = grid_scale(env), observed(state)
        level = jnp.round(speed_level(grid, env.sim.ctrl_dt, motion.speed))
        goal_pose = state.layout.parked_pose[state.goal]
        bearing = bearing_index(grid, to_local(motion.pose_w, goal_pose))
        values = {
            "level": (level + grid.max_reverse)[:, None],
            "bearing": bearing[:, None],
        }
        return values | ring_counts(self.rings, ObservationInput.of(state))

    @property
    def circles(self) -> tuple[float, ...]:
        """Diameters of the rings."""
        return self.rings.diameters

    def init_memory(self, env: EnvConfig) -> dict[str, jax.Array]:
        """What the rings counted before: nothing."""
        return init_history(self.rings, env.num_agents)

    def remember(self, state: State) -> dict[str, jax.Array]:
        """What the rings have counted."""
        return update_history(self.rings, state)


ENCODERS.register("indices", IndexObservation)

"""The back ends `grid…`: the grid world of Tanner 2022 (arXiv 2206.13338).

Whole numbers inside: a point, a level of speed and a heading, which counts clockwise
from +y as in the study. They become metres and radians only in `read`. A car moves by
its new speed along its new heading, to the nearest point, and cannot turn at standstill
unless `GridConfig.turn_at_rest`: the reference implementation forbids it, the paper
does not say so, and in the recorded Q-learning runs, which are older, cars turn.
Nothing stops a car: the task detects collisions, at the ends of steps only, as in the
reference implementation.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config import PHYSICS, WORLD_UNIT, EnvConfig, PhysicsConfig, SimConfig
from carpark_mj.config.checks import Count
from carpark_mj.physics.base import Physics, require_plain_ground
from carpark_mj.types import Motion
from carpark_mj.vehicle.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class GridConfig(PhysicsConfig):
    """The velocity motion model on a grid; the defaults follow the study's PPO.

    Attributes:
        points: grid points per world unit, 0.5625 m: the study's position granularity
            squared. Its text has 2 to its power instead, which contradicts the 74 x 74
            points it counts for a granularity of 1.
        speed_step: points per step that one level of speed moves (G_v).
        headings: equally spaced headings, the first along +y (G_theta).
        max_forward: highest level of speed forwards.
        max_reverse: highest level of speed in reverse.
        max_acceleration: most levels of speed by which one action changes the speed.
        max_turn: most headings by which one action turns the car.
        turn_at_rest: whether a car at standstill turns, too.
        back_end: fixed.
    """

    points: Count = 16
    speed_step: Count = 4
    headings: Count = 24
    max_forward: Count = 4
    max_reverse: Count = 2
    max_acceleration: Count = 2
    max_turn: Count = 3
    turn_at_rest: bool = False
    back_end: str = "grid"
    continuous = 0
    steers = False
    actuated = False
    randomized = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if 2 * self.max_turn >= self.headings:
            raise ValueError(
                f"max_turn must be less than half of {self.headings} headings, not "
                f"{self.max_turn}"
            )

    @property
    def point_size(self) -> float:
        """Distance of neighbouring points [m]."""
        return WORLD_UNIT / self.points

    @property
    def num_levels(self) -> int:
        """Levels of speed, standing still included."""
        return self.max_reverse + 1 + self.max_forward

    @property
    def choices(self) -> tuple[int, int]:
        """Numbers of accelerations and of turns to choose from."""
        return 2 * self.max_acceleration + 1, 2 * self.max_turn + 1

    def make(self, config: EnvConfig, layout: Any, vehicle: Any) -> Any:
        """Builds it; one step takes the control period."""
        del layout, vehicle
        return GridPhysics(self, config.sim)

    def turn(self, before: Any, after: Any, ctrl_dt: float) -> Any:
        """Change of heading."""
        del before
        return abs(after.yaw_rate) * ctrl_dt

    def largest_turn(self, vehicle: Any, ctrl_dt: float) -> float:
        """That of the sharpest turn."""
        del vehicle, ctrl_dt
        return self.max_turn * 2 * math.pi / self.headings

    def yaw_rate_step(self, ctrl_dt: float) -> np.float32:
        """The yaw rate of a turn by one heading [rad/s]."""
        return np.float32(2 * math.pi / self.headings / ctrl_dt)

    def top_yaw_rate(self, ctrl_dt: float) -> float:
        """That of the sharpest turn."""
        return float(self.max_turn * self.yaw_rate_step(ctrl_dt))

    def top_speed(self, vehicle: Any, ctrl_dt: float) -> float:
        """That of the highest level."""
        del vehicle
        level = self.speed_step * self.point_size / ctrl_dt
        return level * max(self.max_forward, self.max_reverse)


FINE = GridConfig()  # of the study's PPO
# Of its Q-learning, table C.1, and of the runs of figure 5.1 as they were recorded.
COARSE = GridConfig(
    points=1,
    speed_step=1,
    headings=8,
    max_forward=1,
    max_reverse=1,
    max_acceleration=1,
    max_turn=1,
)
RECORDED = dataclasses.replace(COARSE, turn_at_rest=True)


def grid_scale(config: EnvConfig) -> GridConfig:
    """The grid whose levels and headings are observed: the fine one for other cars."""
    physics = config.physics_config
    return physics if isinstance(physics, GridConfig) else FINE


PHYSICS.register("grid", FINE)
PHYSICS.register("grid_coarse", COARSE)
PHYSICS.register("grid_recorded", RECORDED)


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


@struct.dataclass
class GridState:
    """Cars on the grid; any leading batch shape, all but `vehicle` int32."""

    point: jax.Array  # (..., 2) x and y of the footprint's centre [points]
    level: jax.Array  # (...) of speed, forwards positive
    heading: jax.Array  # (...) index in [0, headings), clockwise from +y
    turn: jax.Array  # (...) headings turned in the last step, clockwise positive
    vehicle: Vehicle  # parameters, of which only the size has an effect


class GridPhysics(Physics[GridState]):
    """Grid dynamics behind the `Physics` interface; controls are indices.

    `step` takes (..., 2) int32: an acceleration and a turn out of `GridConfig.choices`,
    index 0 being the hardest braking (or reversing) and the sharpest left turn.
    """

    def __init__(self, grid: GridConfig, sim: SimConfig) -> None:
        """Tabulates the moves; one step takes the control period of `sim`."""
        require_plain_ground(sim, "grid")
        self.grid = self.config = grid
        self.ctrl_dt = sim.ctrl_dt
        self._level_speed = grid.speed_step * grid.point_size / sim.ctrl_dt  # m/s
        turn = 2 * math.pi / grid.headings
        angle = turn * np.arange(grid.headings)
        along = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
        reach = grid.speed_step * np.arange(-grid.max_reverse, grid.max_forward + 1)
        # To the nearest point; halves go to even numbers, but sin 30 deg is no half in
        # floating point, and moves to opposite sides must be equally long.
        moves = np.round(np.round(reach[:, None, None] * along, 9))
        self._moves = jnp.array(moves, jnp.int32)  # (levels, headings, 2)
        yaw = np.pi / 2 - angle
        self._yaw = jnp.array((yaw + np.pi) % (2 * np.pi) - np.pi, jnp.float32)
        self._turn = turn

    def init(self, pose_w: jax.Array, vehicle: Vehicle) -> GridState:
        """Cars at rest on the nearest point and heading; see `Physics.init`."""
        point = jnp.round(pose_w[..., :2] / self.grid.point_size).astype(jnp.int32)
        heading = jnp.round((jnp.pi / 2 - pose_w[..., 2]) / self._turn)
        still = jnp.zeros(pose_w.shape[:-1], jnp.int32)
        return GridState(
            point=point,
            level=still,
            heading=jnp.mod(heading.astype(jnp.int32), self.grid.headings),
            turn=still,
            vehicle=vehicle,
        )

    def set_speed(self, state: GridState, speed: jax.Array) -> GridState:
        """Cars (...) as they stand, at the levels nearest to speeds (...) [m/s]."""
        level = jnp.round(speed / self._level_speed).astype(jnp.int32)
        level = jnp.clip(level, -self.grid.max_reverse, self.grid.max_forward)
        return dataclasses.replace(state, level=level)

    def step(self, state: GridState, controls: jax.Array) -> GridState:
        """Advances by one control step; `controls` (..., 2) indices."""
        grid = self.grid
        level = state.level + controls[..., 0] - grid.max_acceleration
        level = jnp.clip(level, -grid.max_reverse, grid.max_forward)
        turn = controls[..., 1] - grid.max_turn
        if not grid.turn_at_rest:
            turn = jnp.where(level == 0, 0, turn)
        heading = jnp.mod(state.heading + turn, grid.headings)
        point = state.point + self._moves[level + grid.max_reverse, heading]
        return dataclasses.replace(
            state, point=point, level=level, heading=heading, turn=turn
        )

    def read(self, state: GridState) -> Motion:
        """Metres and radians; the speed is the level's, before rounding to points."""
        xy = state.point * jnp.float32(self.grid.point_size)
        pose = jnp.concatenate([xy, self._yaw[state.heading][..., None]], axis=-1)
        speed = state.level * jnp.float32(self._level_speed)
        still = jnp.zeros_like(speed)
        return Motion(
            pose_w=pose,
            velocity_b=jnp.stack([speed, still], axis=-1),
            yaw_rate=-state.turn * self.grid.yaw_rate_step(self.ctrl_dt),
            steering=still,
            size=state.vehicle.size,
            trace_w=pose[..., None, :],
            finite=jnp.ones(speed.shape, bool),
        )

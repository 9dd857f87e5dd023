"""The velocity motion model on a grid: the dynamics of Tanner 2022 (arXiv 2206.13338).

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

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from carpark_mj.config import SimConfig
from carpark_mj.physics.base import FactoredPhysics, require_plain_ground
from carpark_mj.types import Motion
from carpark_mj.vehicle.vehicle import Vehicle
from carpark_papers.tanner.grid_config import GridConfig


@struct.dataclass
class GridState:
    """Cars on the grid; any leading batch shape, all but `vehicle` int32.

    Attributes:
        point: (..., 2) x and y of the footprint's centre [points].
        level: (...) of speed, forwards positive.
        heading: (...) index in [0, headings), clockwise from +y.
        turn: (...) headings turned in the last step, clockwise positive.
        vehicle: parameters, of which only the size has an effect.
    """

    point: jax.Array
    level: jax.Array
    heading: jax.Array
    turn: jax.Array
    vehicle: Vehicle


class GridPhysics(FactoredPhysics[GridState]):
    """Grid dynamics behind the `Physics` interface; controls are indices.

    `step` takes (..., 2) int32: an acceleration and a turn out of `GridConfig.choices`,
    index 0 being the hardest braking (or reversing) and the sharpest left turn.
    """

    def __init__(self, grid: GridConfig, sim: SimConfig) -> None:
        """Tabulates the moves.

        Args:
            grid: granularities.
            sim: whose control period one step takes.

        Raises:
            ValueError: a slope, a slippery surface or tyres, which have no meaning.
        """
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

"""Movers as bodies of a scene: solids that follow their own laws and stop cars.

Their poses change from substep to substep. MuJoCo takes them to stand still meanwhile:
a contact pushes a car by how deep it is, not by a mover's velocity.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jax.typing import ArrayLike

from carpark_mj.geometry.obstacles import Boxes, Group
from carpark_mj.layouts.types import MOVER_HEIGHTS
from carpark_mj.obstacles import poses_during
from carpark_mj.scene.parts import HIDDEN

# m; hulls crush that far at 14 m/s. What is deeper inside a car has appeared there.
DEEPEST = 0.3


class Solids(NamedTuple):
    """Movers of a batch of scenes of shape `(...)` in a substep.

    Attributes:
        position: (..., n, 3) of their feet [m], far below the ground if absent.
        yaw: (..., n) [rad].
        size: (..., n, 3) `geom_size` of MuJoCo [m].
    """

    position: ArrayLike
    yaw: ArrayLike
    size: ArrayLike


def absent(count: int) -> Solids:
    """Movers of a scene of which none is there."""
    position = jnp.tile(jnp.array([0.0, 0.0, HIDDEN]), (count, 1))
    return Solids(position, jnp.zeros(count), jnp.ones((count, 3)))


def solids_within(
    before: Sequence[Group],
    after: Sequence[Group],
    left: jax.Array,
    pose_w: jax.Array,
    size: jax.Array,
) -> Solids:
    """Movers when a share () of a control step is left; the groups' order.

    One that is far inside a car would throw it up: it is left out until the car is
    elsewhere.

    Args:
        before: where they are at its start.
        after: where they are at its end.
        left: () share of the step.
        pose_w: (num_agents, 3) agents' cars.
        size: (num_agents, 2) their lengths and widths [m].
    """
    core = size[:, None] - 2.0 * DEEPEST
    rows = [absent(0)]
    for old, new in zip(before, after, strict=True):
        pose = poses_during(old, new, left[None])[:, 0]
        now = dataclasses.replace(new, pose_w=pose)
        there = ~now.overlap(pose_w[:, None], core).any(axis=0)
        there = there if new.mask is None else there & new.mask
        feet = jnp.pad(pose[:, :2], ((0, 0), (0, 1)))
        feet = jnp.where(there[:, None], feet, absent(new.count).position)
        half = jnp.full((new.count, 1), MOVER_HEIGHTS[type(new)] / 2, feet.dtype)
        if isinstance(new, Boxes):
            yaw, size = pose[:, 2], jnp.concatenate([new.size / 2, half], axis=1)
        else:
            columns = (new.size[:, None], half, jnp.zeros_like(half))
            yaw, size = jnp.zeros(new.count), jnp.concatenate(columns, axis=1)
        rows.append(Solids(feet, yaw, size))
    return Solids(*map(jnp.concatenate, zip(*rows, strict=True)))


class MoverBodies:
    """Where the bodies of `carpark_mj.scene.movers.add_solids` are in a model.

    Attributes:
        count: of movers.
        geoms: (count,) their geoms.
        kinds: (count,) `ObstacleKind` of each.
    """

    def __init__(self, model: mujoco.MjModel, groups: Sequence[Group]) -> None:
        """Looks them up; `groups` as in `add_solids`."""
        self.count = sum(group.count for group in groups)
        names = [f"mover{number}" for number in range(self.count)]
        self.geoms = np.array([model.geom(name).id for name in names], int)
        self.kinds = np.array([g.kind for g in groups for _ in range(g.count)], int)
        bodies = model.geom_bodyid[self.geoms]
        self._mocap = model.body_mocapid[bodies]

    def place(self, model: mujoco.MjModel, data: mujoco.MjData, solids: Solids) -> None:
        """Puts the bodies of one scene where `solids` are, and of their sizes."""
        position, yaw, size = (np.asarray(x, float) for x in solids)
        data.mocap_pos[self._mocap] = position
        still = np.zeros_like(yaw)
        quat = np.stack([np.cos(yaw / 2), still, still, np.sin(yaw / 2)], axis=-1)
        data.mocap_quat[self._mocap] = quat
        model.geom_size[self.geoms] = size
        # Of a box and of a cylinder; pairs of geoms read no other bound.
        model.geom_rbound[self.geoms] = np.linalg.norm(size, axis=-1)

"""A layout: the plan of a lot as a pytree of padded arrays.

Masks say which rows count, so lots of different shapes share one compiled program and
one batch. Padding rows hold finite numbers (zeros).
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct


@struct.dataclass
class Layout:
    """The plan of a lot; world frame, SI units.

    Attributes:
        bay_pose: (..., bays, 3) centre and heading of each bay [m, m, rad]; the
            heading is that of a car parked in it as parked cars are.
        bay_size: (..., bays, 2) length along the heading and width [m].
        bay_mask: (..., bays) bool.
        wall_pose: (..., walls, 3) centre and heading of each wall or block.
        wall_size: (..., walls, 2) length and width [m].
        wall_mask: (..., walls) bool.
        spawn_pose: (..., regions, 3) rectangles in which car centres may spawn.
        spawn_size: (..., regions, 2) [m]; a region is drawn in proportion to its area.
        spawn_mask: (..., regions) bool.
        extent: (..., 2) half width in x and half width in y of the whole lot, about
            the origin [m].
    """

    bay_pose: jax.Array
    bay_size: jax.Array
    bay_mask: jax.Array
    wall_pose: jax.Array
    wall_size: jax.Array
    wall_mask: jax.Array
    spawn_pose: jax.Array
    spawn_size: jax.Array
    spawn_mask: jax.Array
    extent: jax.Array

    @property
    def num_bays(self) -> int:
        """Bays, padding included."""
        return self.bay_mask.shape[-1]

    def is_well_formed(self) -> list[str]:
        """Checks one layout (no batch dimension) on the host.

        Returns:
            What is wrong, a sentence each; empty when the layout is sound: shapes and
            dtypes fit, numbers are finite, sizes positive, at least one bay and one
            spawn region exist, bays lie within the extent and do not overlap each
            other or a wall, and spawn regions reach no wall.
        """
        from carpark_mj.geometry import box_inside, boxes_overlap

        problems = []
        for name in ("bay", "wall", "spawn"):
            pose, size = getattr(self, f"{name}_pose"), getattr(self, f"{name}_size")
            mask = getattr(self, f"{name}_mask")
            rows = mask.shape[-1]
            if pose.shape != (rows, 3) or size.shape != (rows, 2):
                problems.append(f"{name}: shapes {pose.shape}, {size.shape}, ({rows},)")
                continue
            if mask.dtype != jnp.bool_:
                problems.append(f"{name}_mask must be bool, not {mask.dtype}")
                continue
            for part, array in (("pose", pose), ("size", size)):
                if array.dtype != jnp.float32:
                    problems.append(f"{name}_{part} must be float32, not {array.dtype}")
            if not bool(jnp.isfinite(pose).all() & jnp.isfinite(size).all()):
                problems.append(f"{name} holds a non-finite number")
            if bool(jnp.any((size <= 0) & mask[:, None])):
                problems.append(f"{name}_size must be positive")
        if problems:
            return problems
        if not bool(self.bay_mask.any()):
            problems.append("there is no bay")
        if not bool(self.spawn_mask.any()):
            problems.append("there is no spawn region")
        lot_pose, lot_size = jnp.zeros(3), 2.0 * self.extent * (1.0 + 1e-6)
        inside = box_inside(self.bay_pose, self.bay_size, lot_pose, lot_size)
        outside = np.flatnonzero(np.asarray(self.bay_mask & ~inside))
        if outside.size:
            problems.append(f"bays {outside.tolist()} lie outside the extent")
        # Neighbours share an edge: shrink by a rounding error before testing.
        bay_size = self.bay_size - 1e-3
        pairs = boxes_overlap(
            self.bay_pose[:, None], bay_size[:, None], self.bay_pose, bay_size
        )
        pairs = pairs & self.bay_mask[:, None] & self.bay_mask
        pairs = np.argwhere(np.triu(np.asarray(pairs), 1))
        if pairs.size:
            problems.append(f"bays overlap: {pairs[:3].tolist()}")
        for name, pose, size, mask in (
            ("bays", self.bay_pose, bay_size, self.bay_mask),
            ("spawn regions", self.spawn_pose, self.spawn_size, self.spawn_mask),
        ):
            hits = boxes_overlap(
                pose[:, None], size[:, None], self.wall_pose, self.wall_size
            )
            hits = hits & mask[:, None] & self.wall_mask
            if bool(hits.any()):
                problems.append(f"{name} {np.argwhere(hits)[:3].tolist()} meet walls")
        return problems


def pad(layout: Layout, bays: int, walls: int, regions: int) -> Layout:
    """Pads one layout to the given numbers of rows.

    Raises:
        ValueError: the layout has more rows than that.
    """
    rows = {"bay": bays, "wall": walls, "spawn": regions}
    changes = {}
    for field in dataclasses.fields(layout):
        name = field.name.split("_")[0]
        if name not in rows:
            continue
        array = getattr(layout, field.name)
        extra = rows[name] - array.shape[0]
        if extra < 0:
            raise ValueError(
                f"a layout with {array.shape[0]} {name} rows cannot be padded to "
                f"{rows[name]}"
            )
        changes[field.name] = jnp.pad(array, [(0, extra)] + [(0, 0)] * (array.ndim - 1))
    return dataclasses.replace(layout, **changes)

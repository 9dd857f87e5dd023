"""Checks of layouts, and messages about their faults.

`find_faults` is pure and runs for thousands of layouts at once under `jax.vmap`;
`describe_faults` describes one layout's faults in sentences.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from carpark_mj import geometry
from carpark_mj.layouts.build import PARTS
from carpark_mj.layouts.standards import PLAUSIBLE_BAY, DesignCar
from carpark_mj.layouts.types import ROWS, BayKind, Layout

ANY_CAR = (0.0, 0.0)  # length and width [m] that all cars have room for

# Neighbours share an edge: sizes shrink by rounding errors before they are compared.
ROUNDING = 1e-3  # m
_Rows = tuple[jax.Array, jax.Array, jax.Array]
# Rows that messages of `find_faults` concern, by their first words.
_SUBJECTS = {"bays": "bay", "lanes": "lane", "cars": "spawn"}


def find_faults(layout: Layout, car_size: jax.Array) -> dict[str, jax.Array]:
    """Faults of one layout (no batch dimension) whose shapes and dtypes are right.

    `car_size` (2,) is the length and width of the largest car [m]. Returns bool arrays,
    True = fault, by the text of its message; one dimension per kind of row it concerns,
    none for the lot as a whole.
    """
    bay = (layout.bay_pose, layout.bay_size - ROUNDING, layout.bay_mask)
    is_exit = layout.bay_mask & (layout.bay_kind == BayKind.EXIT)
    # Lanes lead through exits, and where there are any cars may start in bays.
    off_lane = (*bay[:2], layout.bay_mask & ~is_exit)
    no_start = (*bay[:2], jnp.where(is_exit.any(), is_exit, layout.bay_mask))
    wall = (layout.wall_pose, layout.wall_size, layout.wall_mask)
    disc = (layout.disc_centre, layout.disc_radius, layout.disc_mask)
    lane = (layout.lane_pose, layout.lane_size - ROUNDING, layout.lane_mask)
    reach = geometry.swept_half_size(car_size, layout.spawn_spread)
    swept = layout.spawn_size + 2 * reach - ROUNDING
    swept = (layout.spawn_pose, swept, layout.spawn_mask)
    size = 2.0 * layout.extent * (1.0 + 1e-6)
    inside = geometry.box_inside(layout.bay_pose, layout.bay_size, jnp.zeros(3), size)
    small = jnp.any(layout.bay_size < car_size, axis=-1)
    least, most = PLAUSIBLE_BAY
    odd = jnp.any((layout.bay_size < least) | (layout.bay_size > most), axis=-1)
    return {
        "there is no bay": ~layout.bay_mask.any(),
        "there is no spawn region": ~layout.spawn_mask.any(),
        "bays lie outside the extent": layout.bay_mask & ~inside,
        f"bays are not {least:g} to {most:g} m long and wide, in metres": (
            layout.bay_mask & odd & ~is_exit
        ),
        "bays are smaller than the car": layout.bay_mask & small,
        "bays overlap": jnp.triu(_meet(bay, bay), 1),
        "bays meet walls": _meet(bay, wall),
        "bays meet discs": _meet(bay, disc),
        "lanes meet bays": _meet(lane, off_lane),
        "lanes meet walls": _meet(lane, wall),
        "lanes meet discs": _meet(lane, disc),
        "cars spawning in spawn regions meet walls": _meet(swept, wall),
        "cars spawning in spawn regions meet discs": _meet(swept, disc),
        "cars spawning in spawn regions meet bays": _meet(swept, no_start),
    }


def _meet(a: _Rows, b: _Rows) -> jax.Array:
    """Which boxes overlap which boxes or discs: poses or centres, sizes, masks."""
    overlap = (
        geometry.boxes_overlap if b[0].shape[-1] == 3 else geometry.box_disc_overlap
    )
    return overlap(a[0][:, None], a[1][:, None], *b[:2]) & a[2][:, None] & b[2]


class Fault(NamedTuple):
    """What is wrong in a layout, and where."""

    message: str
    # Of the rows of a place, `ROWS`: two where rows meet, none for the lot as a whole.
    kinds: tuple[str, ...]
    places: np.ndarray  # (places, kinds) int, their rows; (1, 0) for the whole lot


def list_faults(layout: Layout, car_size: tuple[float, float]) -> list[Fault]:
    """Faults of one layout whose shapes, dtypes and numbers are right, on the host."""
    found: list[Fault] = []
    faults = _find_faults(_padded(layout), jnp.array(car_size, jnp.float32))
    for message, fault in jax.device_get(faults).items():
        if fault.any():
            subject, *_, other = message.split()
            kind, met = _SUBJECTS.get(subject, ""), other.removesuffix("s")
            kinds = (kind, met if met in ROWS else kind)[: fault.ndim]
            found.append(Fault(message, kinds, np.argwhere(fault)))
    return found


def describe_faults(
    layout: Layout, car_size: tuple[float, float] | None = None
) -> list[str]:
    """Faults of one layout, a sentence each; runs on the host.

    A valid layout has matching shapes and dtypes, finite numbers and positive sizes, at
    least one bay and one spawn region; its bays lie within the extent, hold the car
    and overlap neither each other nor walls, discs or lanes; no wall or disc stands in
    a lane; and a car that spawns anywhere in a spawn region, at any heading it allows,
    touches no wall, disc or bay. Exits may lie on lanes; in a lot with exits cars may
    spawn in the other bays.

    The layout has no batch dimension; the largest car has a length and a width [m],
    those of the design car if None, `ANY_CAR` for what does not depend on cars.
    """
    if found := _malformed(layout):
        return found
    for message, kinds, places in list_faults(layout, car_size or DesignCar().size):
        rows = places[:3, 0] if len(kinds) == 1 else places[:3]
        found.append(f"{message}: {rows.tolist()}" if kinds else message)
    return found


_find_faults = jax.jit(find_faults)


def _padded(layout: Layout) -> Layout:
    """The layout with 64, 128, 256... rows of a kind: few shapes, so few programs."""
    changes: dict[str, Any] = {}
    for name, array in vars(layout).items():
        if name.split("_")[0] in ROWS and array is not None:
            extra = max(64, 1 << (len(array) - 1).bit_length()) - len(array)
            changes[name] = np.pad(array, [(0, extra)] + [(0, 0)] * (array.ndim - 1))
    return dataclasses.replace(layout, **changes)


def _malformed(layout: Layout) -> list[str]:
    """Wrong shapes, dtypes and numbers."""
    found = []
    for kind in ROWS:
        mask = np.asarray(getattr(layout, f"{kind}_mask"))
        if mask.ndim != 1 or mask.dtype != jnp.bool_:
            found.append(f"{kind}_mask must be bool of one dimension, not {mask.dtype}")
            continue
        for part, (trailing, dtype) in PARTS.items():
            given = getattr(layout, f"{kind}_{part}", None)
            if given is None:
                continue
            name, array = f"{kind}_{part}", np.asarray(given)
            shape = (*mask.shape, *trailing)
            if array.shape != shape or array.dtype != dtype:
                wanted, had = f"{jnp.dtype(dtype)}{[*shape]}", [*array.shape]
                found.append(f"{name} must be {wanted}, not {array.dtype}{had}")
            elif not np.isfinite(array).all():
                found.append(f"{name} holds a non-finite number")
            elif part in ("size", "radius") and (array[mask] <= 0).any():
                found.append(f"{name} must be positive")
            elif part == "spread" and (array[mask] < 0).any():
                found.append(f"{name} must not be negative")
    if not np.isfinite(layout.extent).all():
        found.append("extent holds a non-finite number")
    return found

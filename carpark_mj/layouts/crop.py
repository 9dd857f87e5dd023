"""A part of a lot."""

import dataclasses
from typing import Any

import jax
import numpy as np

from carpark_mj.geometry import box_corners, point_box_distance
from carpark_mj.layouts.types import ROWS, Layout

SHORTEST = 1.0  # m of what is left of a lane
ASIDE = 1.0  # m that the lane in front of a bay may be farther away in the part
THINNEST = 0.05  # m of what is left of a wall or a spawn region


def crop(layout: Layout, corners: tuple[float, float, float, float]) -> Layout:
    """The part of a lot between two corners, its middle at the origin.

    Bays and discs are kept whole or not at all, bays only with the lane in front of
    them; walls, lanes and spawn regions end where their centre lines leave the part.

    Args:
        layout: no batch dimension.
        corners: x and y of one corner, x and y of the opposite one [m].

    Returns:
        Numpy arrays.

    Raises:
        ValueError: the part has no bay, or no spawn region.
    """
    low, high = np.sort(np.array(corners, float).reshape(2, 2), axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    plan: Any = jax.device_get(layout)
    fields: dict[str, Any] = {
        field.name: np.array(getattr(plan, field.name))
        for field in dataclasses.fields(plan)
        if getattr(plan, field.name) is not None
    }
    masks = {
        "bay": np.all(
            np.abs(np.asarray(box_corners(plan.bay_pose, plan.bay_size)) - middle)
            <= half,
            axis=(-2, -1),
        ),
        "disc": (np.abs(plan.disc_centre - middle) <= half).all(axis=-1),
    }
    for row, least in (("wall", THINNEST), ("lane", SHORTEST), ("spawn", THINNEST)):
        pose, size = fields[f"{row}_pose"], fields[f"{row}_size"]
        back, front = _within(pose, size[:, 0], low, high)
        ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
        pose[:, :2] += ahead * ((back + front) / 2)[:, None]
        masks[row] = front - back > np.minimum(least, size[:, 0] / 2)
        size[:, 0] = front - back
    if len(plan.lane_mask):
        cut = fields["lane_pose"], fields["lane_size"], masks["lane"] & plan.lane_mask
        before = _to_lane(plan, plan.lane_pose, plan.lane_size, plan.lane_mask)
        masks["bay"] = masks["bay"] & (_to_lane(plan, *cut) < before + ASIDE)
    for row in ROWS:
        keep = fields[f"{row}_mask"] & masks[row]
        for name in fields:
            if name.startswith(f"{row}_"):
                fields[name] = fields[name][keep]
        for part in ("pose", "centre"):
            if f"{row}_{part}" in fields:
                fields[f"{row}_{part}"][:, :2] -= middle.astype(np.float32)
    fields["extent"] = half.astype(np.float32)
    for row, what in (("bay", "whole bay"), ("spawn", "spawn region")):
        if not len(fields[f"{row}_mask"]):
            raise ValueError(
                f"there is no {what} between the corners {tuple(low.tolist())} and "
                f"{tuple(high.tolist())}; the lot reaches from "
                f"{(-plan.extent).tolist()} to {plan.extent.tolist()}"
            )
    return Layout(**fields)


def _to_lane(plan: Any, pose: Any, size: Any, mask: np.ndarray) -> np.ndarray:
    """Distance (bays,) from the front end of each bay to the nearest lane [m]."""
    bays = plan.bay_pose
    ahead = np.stack([np.cos(bays[:, 2]), np.sin(bays[:, 2])], axis=-1)
    front = bays[:, :2] + plan.bay_size[:, :1] / 2 * ahead
    gap = np.asarray(point_box_distance(front, pose[:, None], size[:, None]))
    return np.where(mask[:, None], gap, np.inf).min(axis=0)


def _within(
    pose: np.ndarray, length: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The part of each centre line in a rectangle, from its middle [m]."""
    ahead = np.stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])], axis=-1)
    ahead = np.where(np.abs(ahead) < 1e-9, 1e-9, ahead)
    first, second = (low - pose[:, :2]) / ahead, (high - pose[:, :2]) / ahead
    back = np.maximum(np.minimum(first, second).max(axis=1), -length / 2)
    front = np.minimum(np.maximum(first, second).min(axis=1), length / 2)
    return back, front

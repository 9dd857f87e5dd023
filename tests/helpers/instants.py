"""Instants for pictures, and colours in these."""

import numpy as np

from carpark_mj.rendering.stage import Snapshot


def instant(pose, parked=(), layout=None, goal=(), **more):
    """Agents and parked cars at poses (n, 3), with goals in a layout or without."""
    pose = np.asarray(pose, float).reshape(-1, 3)
    goal_pose = np.full_like(pose, np.nan)
    goal_size = goal_pose[:, :2]
    if layout is not None:
        goal_pose, goal_size = (
            np.asarray(x)[np.asarray(goal)] for x in (layout.bay_pose, layout.bay_size)
        )
    made = {"active": np.ones(len(pose), bool), "steering": np.zeros(len(pose))} | more
    return Snapshot(
        pose_w=pose,
        goal_pose=goal_pose,
        goal_size=goal_size,
        parked_pose=np.asarray(parked, float).reshape(-1, 3),
        **made,
    )


def hue_distance(pixel, colour):
    """Angles [deg] between colours (..., 3) and one, however bright each is."""
    a, b = np.asarray(pixel, float), np.asarray(colour[:3], float)
    cos = a @ b / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b) + 1e-9)
    return np.degrees(np.arccos(np.clip(cos, -1, 1)))

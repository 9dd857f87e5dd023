"""Options of `reset` as other libraries pass them: dictionaries, one for an agent."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from carpark_mj.config.checks import is_finite, require_count, require_kind
from carpark_mj.spawning.reset_options import ResetOptions
from carpark_mj.types import NO_BAY

KEYS = ("pose", "speed", "goal")


def as_reset_options(
    options: Sequence[Mapping[str, Any] | None], shape: tuple[int, int]
) -> ResetOptions | None:
    """Options (lots, num_agents, ...) of those of single agents; None if all are empty.

    Args:
        options: of each agent of each lot: `pose`, start pose (x, y, yaw) of the
            footprint's centre in the world frame [m, m, rad]; `speed`, forwards
            positive [m/s]; `goal`, the index of a bay. Missing poses and goals are
            drawn; a car without a speed begins at rest.
        shape: lots and agents in a lot.

    Raises:
        TypeError: `options` are not dictionaries.
        ValueError: an unknown key, or an impossible value.
    """
    rows = [_checked(row) for row in options]
    if not any(rows):
        return None
    nothing = {"pose": (np.nan,) * 3, "speed": np.nan, "goal": NO_BAY}
    given: dict[str, Any] = {
        key: np.array([row.get(key, nothing[key]) for row in rows], dtype)
        for key, dtype in zip(KEYS, (np.float32, np.float32, np.int32), strict=True)
        if any(key in row for row in rows)
    }
    return ResetOptions(
        **{key: x.reshape(*shape, *x.shape[1:]) for key, x in given.items()}
    )


def _checked(options: Mapping[str, Any] | None) -> dict[str, Any]:
    """The options of an agent."""
    require_kind("options", options, Mapping | None)
    row = dict(options or {})
    for key in row:
        if key not in KEYS:
            raise ValueError(f"unknown option {key!r} of reset; choose from {KEYS}")
    if "pose" in row:
        pose = row["pose"]
        if np.shape(pose) != (3,) or not all(map(is_finite, pose)):
            raise ValueError(
                f"pose must be three finite numbers (x, y, yaw), not {pose!r}"
            )
    if "speed" in row and not is_finite(row["speed"]):
        raise ValueError(f"speed must be a finite number, not {row['speed']!r}")
    if "goal" in row:
        require_count("goal", row["goal"], 0)
    return row

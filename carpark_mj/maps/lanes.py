"""Lanes of a map, joined to the long straight ones that layouts have."""

import dataclasses
import math
from typing import Any

import numpy as np
import shapely

from carpark_mj.maps.features import Feature
from carpark_mj.maps.fit import Box

ALIGNED = math.radians(6.0)  # between lanes that are one
ASIDE = 0.8  # m between the centre lines of lanes that are one
GAP = 8.0  # m between their ends, for one to cross a junction


def joined_lanes(features: list[Feature]) -> list[tuple[Box, bool]]:
    """Rectangles of lanes, and whether they are driven along their heading only.

    Lanes in line are joined. Two opposite lanes on the same ground become one two-way
    lane.
    """
    features = [one for one in features if one.shape.length > 0.1]
    if not features:
        return []
    ends = np.array([np.asarray(one.shape.coords)[[0, -1]] for one in features])
    step = ends[:, 1] - ends[:, 0]
    length, yaw = np.hypot(*step.T), np.arctan2(step[:, 1], step[:, 0])
    middle = ends.mean(axis=1)
    width = np.array([one.width for one in features])
    only = np.array([one.one_way for one in features])
    free = np.full(len(features), True)
    lanes, one_way = [], []
    for first in np.argsort(-length, kind="stable"):
        if not free[first]:
            continue
        cosine, sine = math.cos(yaw[first]), math.sin(yaw[first])
        local = (ends - middle[first]) @ np.array([[cosine, -sine], [sine, cosine]])
        in_line = (np.abs(np.sin(yaw - yaw[first])) <= math.sin(ALIGNED)) & (
            np.abs(local[..., 1]).max(axis=1) <= ASIDE
        )
        low, high = local[..., 0].min(axis=1), local[..., 0].max(axis=1)
        back, front = -length[first] / 2, length[first] / 2
        joined = np.arange(len(features)) == first
        while True:
            within = (low <= front + GAP) & (high >= back - GAP)
            more = free & in_line & within & ~joined
            if not more.any():
                break
            joined |= more
            back, front = low[joined].min(), high[joined].max()
        free &= ~joined
        mean = float(np.average(width[joined], weights=length[joined]))
        x, y = (float(value) for value in middle[first])
        whole = Box(x, y, float(yaw[first]), float(length[first]), mean)
        lanes.append(whole.part(float(back), float(front), -mean / 2, mean / 2))
        with_it = np.cos(yaw[joined] - yaw[first]) >= 0
        one_way.append(bool((only[joined] & with_it).all()))
    return list(zip(_reaching(lanes), one_way, strict=True))


def _reaching(lanes: list[Box]) -> list[Box]:
    """Lanes lengthened at either end to the next one ahead, within `GAP`."""
    x, y, yaw, length, _ = np.array([dataclasses.astuple(lane) for lane in lanes]).T
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    # Ends of all lanes in their headings, and then their other ends.
    out = np.concatenate([ahead, -ahead])
    ends = np.tile(np.stack([x, y], axis=-1), (2, 1))
    ends = ends + out * np.tile(length / 2, 2)[:, None]
    rays: Any = shapely.linestrings(np.stack([ends, ends + GAP * out], axis=1))
    shapes = np.array([lane.shape for lane in lanes])
    ray, other = shapely.STRtree(shapes).query(rays, "intersects")
    ray, other = np.stack([ray, other])[:, ray % len(lanes) != other]
    hits = shapely.intersection(rays[ray], shapes[other])
    gaps = np.full(len(rays), np.inf)
    np.minimum.at(gaps, ray, shapely.distance(hits, shapely.points(ends[ray])))
    front, back = np.where(np.isfinite(gaps), gaps, 0.0).reshape(2, -1)
    return [
        lane.part(
            -lane.length / 2 - before,
            lane.length / 2 + after,
            -lane.width / 2,
            lane.width / 2,
        )
        for lane, before, after in zip(lanes, back, front, strict=True)
    ]

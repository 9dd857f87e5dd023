"""When a car drives along its path among cars whose drives are known.

A path is driven with a trapezoidal speed profile; where another car is in the way, the
car waits before it pulls away or stops on its path, so that it arrives as early as
possible (path-velocity decomposition, Kant and Zucker 1986).
"""

import math
from typing import NamedTuple

import numpy as np

from carpark_mj.planning.paths import (
    SHIFT_TIME,
    PlannedPath,
    centre,
    slow_down,
    speed_limit,
)
from carpark_mj.vehicle import VehicleParameters

DT = 0.2  # s between instants
CRUISE = 2.5  # m/s, highest speed
ACCELERATION = 1.5  # m/s^2, by which cars speed up and slow down
STOP = CRUISE / ACCELERATION  # s, least loss of a stop on the way


class Drive(NamedTuple):
    """What a car does from the beginning; afterwards it stands at the last pose."""

    # (n, 3) of the footprint's centre, without repetitions while it waits
    pose: np.ndarray
    point: np.ndarray  # (t,) which of them, at instants `DT` apart
    size: np.ndarray  # (2,) length and width [m]

    def at(self, instants: np.ndarray) -> np.ndarray:
        """Which poses, at these instants (k,)."""
        return self.point[np.minimum(instants, len(self.point) - 1)]

    @property
    def seconds(self) -> float:
        """Time of the arrival [s]."""
        return DT * (len(self.point) - 1)


def instants(path: PlannedPath, car: VehicleParameters) -> np.ndarray:
    """Poses (n, 3) of the footprint's centre, `DT` apart, on a path without stops."""
    now, wheels = 0.0, 0.0
    times, poses = [], []
    for segment in path.segments:
        gap = np.diff(segment.distance)
        now += abs(float(segment.steering[0]) - wheels) / car.steering_rate
        now += SHIFT_TIME if times else 0.0
        wheels = float(segment.steering[-1])
        speed = speed_limit(segment.distance, segment.steering, car, CRUISE)
        speed[[0, -1]] = 0.0
        slow_down(speed[::-1], gap[::-1], ACCELERATION)
        slow_down(speed, gap, ACCELERATION)
        taken = 2 * gap / (speed[1:] + speed[:-1])
        begun = now + np.concatenate([[0.0], np.cumsum(taken)])
        times.append(begun)
        poses.append(segment.pose)
        now = float(begun[-1])
    time, pose = np.concatenate(times), centre(car, np.concatenate(poses))
    yaw = np.unwrap(pose[:, 2])
    at = DT * np.arange(math.ceil(now / DT) + 1)
    return np.column_stack([np.interp(at, time, x) for x in (*pose[:, :2].T, yaw)])


def meet(
    pose: np.ndarray, size: np.ndarray, other: np.ndarray, other_size: np.ndarray
) -> np.ndarray:
    """(n, m) bool, which poses (n, 3), (m, 3) of two rectangles overlap (SAT)."""
    dx = other[:, 0] - pose[:, None, 0]
    dy = other[:, 1] - pose[:, None, 1]
    found = np.hypot(dx, dy) < (math.hypot(*size) + math.hypot(*other_size)) / 2
    rows, columns = np.nonzero(found)
    x, y, a, b = dx[found], dy[found], pose[rows, 2], other[columns, 2]
    half, other_half = np.asarray(size) / 2, np.asarray(other_size) / 2
    c, s = np.abs(np.cos(b - a)), np.abs(np.sin(b - a))
    apart = np.zeros(len(x), bool)
    for yaw, own, its in ((a, half, other_half), (b, other_half, half)):
        along = np.abs(np.cos(yaw) * x + np.sin(yaw) * y)
        across = np.abs(np.cos(yaw) * y - np.sin(yaw) * x)
        apart |= along >= own[0] + its[0] * c + its[1] * s
        apart |= across >= own[1] + its[0] * s + its[1] * c
    found[rows, columns] = ~apart
    return found


def schedule(
    pose: np.ndarray, size: np.ndarray, others: list[Drive], begin: int
) -> np.ndarray | None:
    """The earliest arrival on a path among cars whose drives are known.

    Args:
        pose: (n, 3) of a car that drives without stops, `DT` apart.
        size: (2,) of it.
        others: drives of the other cars.
        begin: instant from which it may pull away.

    Returns:
        (t,) which pose at every instant from 0 to the arrival; None if there is none.
    """
    count, wait = len(pose), round(STOP / DT)
    last = max((len(other.point) for other in others), default=0)
    total = max(last, begin) + count + wait + 2
    free = np.ones((total, count), bool)
    for other in others:
        taken = meet(pose, size, other.pose, other.size)
        free &= ~taken[:, other.at(np.arange(total))].T
    stays = np.logical_and.accumulate(free[::-1, -1])[::-1]  # for good, at the end
    moves = np.zeros((total, count), bool)
    stood = np.zeros((total, count), int)
    stood[: begin + 1, 0] = wait
    for t in range(begin, total - 1):
        if stays[t] and (moves[t, -1] or stood[t, -1]):
            return _backtrack(moves, stood, t)
        goes = moves[t] | (stood[t] >= wait)
        # Free in all corners of the cell of time and path: nobody is passed through.
        clear = free[t + 1, 1:] & free[t, 1:] & free[t + 1, :-1]
        moves[t + 1, 1:] = goes[:-1] & clear
        stood[t + 1] = np.where(stood[t] > 0, stood[t] + 1, moves[t]) * free[t + 1]
    return None


def _backtrack(moves: np.ndarray, stood: np.ndarray, t: int) -> np.ndarray:
    """The poses from 0 to an arrival at instant t."""
    point, index = moves.shape[1] - 1, []
    driving = bool(moves[t, point])
    while point:
        if driving:
            index.append(point)
            t, point = t - 1, point - 1
            driving = bool(moves[t, point])
        else:
            pause = int(stood[t, point])
            index += [point] * pause
            t, driving = t - pause, True
    return np.array((index + [0] * (t + 1))[::-1])

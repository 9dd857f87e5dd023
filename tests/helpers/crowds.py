"""Cars that touch each other, for the tests of collisions and terminations."""

import math

import numpy as np
from helpers.scenes import cars


def random_lots(rng, count):
    """Lots of 3 moving agents, 4 bays and 3 walls, crowded into 20 m."""

    def poses(*shape):
        return np.float32(rng.uniform([-10, -10, -3.1], [10, 10, 3.1], (*shape, 3)))

    start, end = poses(count, 3), poses(count, 3)
    end = start + 0.15 * (end - start)
    share = np.linspace(0.25, 1.0, 4)[:, None]
    trace = np.float32(start[..., None, :] * (1 - share) + end[..., None, :] * share)
    size = np.float32(rng.uniform((3.0, 1.5), (5.0, 2.0), (count, 3, 2)))
    walls, wall_size = poses(count, 3), rng.uniform(0.5, 4.0, (count, 3, 2))
    return (
        cars(trace[..., -1, :], size=size, trace=trace),
        poses(count, 4),
        walls,
        np.float32(wall_size),
    )


def crossing(trace_between):
    """Agent 0 passes through agent 1 (standing) from one instant to the next."""
    x = [-6.0, 0.0, 6.0, 6.0] if trace_between else [6.0, 6.0, 6.0, 6.0]
    moving = [(value, 0.0, 0.0) for value in x]
    standing = [(0.0, 0.0, math.pi / 2)] * 4
    return cars([(6.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)], trace=[moving, standing])

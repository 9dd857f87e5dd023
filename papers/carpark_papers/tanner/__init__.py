"""Tanner 2022 (arXiv 2206.13338): agents on a grid around a square."""

from carpark_papers.tanner import (
    grid_config,
    indices,
    observation,
    rewards,
    vehicles,
)

# isort: split
from carpark_papers.tanner import environments, programs  # of what is named above

__all__ = [
    "environments",
    "grid_config",
    "indices",
    "observation",
    "programs",
    "rewards",
    "vehicles",
]

"""Pandita 2022: one car parks between two rows of slots."""

from carpark_papers.pandita import highway_config, layouts, task, vehicles

# isort: split
from carpark_papers.pandita import environments, programs  # of what is named above

__all__ = ["environments", "highway_config", "layouts", "programs", "task", "vehicles"]

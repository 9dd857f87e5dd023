"""Pandita 2022: one car parks between two rows of slots."""

from carpark_papers.pandita import layouts, task

__all__ = ["layouts", "task"]

"""Cederle 2023: automated cars that cross a junction."""

from carpark_papers.cederle import programs

__all__ = ["programs"]

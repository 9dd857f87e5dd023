"""Pandita 2022: parking in slots with SAC and hindsight replay."""

from carpark_mj.studies.pandita import programs

__all__ = ["programs"]

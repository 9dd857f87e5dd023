"""Tanner 2022: agents on a grid that park in one lot (arXiv 2206.13338)."""

from carpark_mj.studies.tanner import rewards

__all__ = ["rewards"]

"""Tanner 2022: parking agents that learn to share a lot."""

from carpark_mj.studies.tanner import programs, rewards

__all__ = ["programs", "rewards"]

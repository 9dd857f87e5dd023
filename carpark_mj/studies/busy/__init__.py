"""Cases in which people, a cart or another car get in the way: the level `busy`."""

from carpark_mj.studies.busy import level, scripts

__all__ = ["level", "scripts"]

"""TPCAP: the published cases of a planning competition, and their car."""

from carpark_mj.studies.tpcap import files, layouts, vehicles

__all__ = ["files", "layouts", "vehicles"]

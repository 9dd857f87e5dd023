"""Hard cases on which policies are compared, of HOPE, TPCAP, ParkBench and others.

Importing the package registers their layouts, cars, movers, environments and levels.
"""

from carpark_mj.suite import (
    busy,
    environments,
    hope,
    lots,
    metadrive,
    parkbench,
    scenario,
    tpcap,
)

__all__ = [
    "busy",
    "environments",
    "hope",
    "lots",
    "metadrive",
    "parkbench",
    "scenario",
    "tpcap",
]

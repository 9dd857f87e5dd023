"""Hard cases on which policies are compared: HOPE, TPCAP, MetaDrive's lot, `busy`.

Importing the package registers their layouts, cars, movers, environments and levels.
"""

from carpark_mj.suite import busy, hope, metadrive, tpcap

__all__ = ["busy", "hope", "metadrive", "tpcap"]

"""Hard cases on which policies are compared, of HOPE, TPCAP and others.

Importing the package registers their layouts, cars, movers, environments and levels.
"""

# They import the others: the cases of HOPE, TPCAP and MetaDrive.
from carpark_mj.suite import busy, environments, lots, scenario, standard_tests

__all__ = ["busy", "environments", "lots", "scenario", "standard_tests"]

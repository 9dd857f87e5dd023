"""`python -m carpark_mj.scene`: see `carpark_mj.cli.scene`."""

import sys

from carpark_mj.cli.scene import run

sys.exit(run())

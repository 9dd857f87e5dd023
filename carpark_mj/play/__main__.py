"""`python -m carpark_mj.play`: see `carpark_mj.cli.play`."""

import sys

from carpark_mj.cli.play import run

sys.exit(run())

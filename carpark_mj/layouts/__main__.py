"""`python -m carpark_mj.layouts`: see `carpark_mj.cli.layouts`."""

import sys

from carpark_mj.cli.layouts import main

sys.exit(main())

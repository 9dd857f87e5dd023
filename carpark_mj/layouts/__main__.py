"""`python -m carpark_mj.layouts`: see `carpark_mj.cli.layouts`."""

import sys

from carpark_mj.cli.common import run_command


def run() -> int:
    """Runs the command; returns the exit code, 1 if a layout has a problem."""
    from carpark_mj.cli.layouts import main

    return main()


sys.exit(run_command("layouts", run))

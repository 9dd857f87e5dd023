"""`python -m carpark_mj.scene`: see `carpark_mj.cli.scene`."""

import sys

from carpark_mj.cli.common import run_command


def run() -> int:
    """Runs the command; returns the exit code."""
    from carpark_mj.cli import scene

    return scene.run()


sys.exit(run_command("scene", run))

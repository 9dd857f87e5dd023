"""`python -m carpark_mj.play`: see `carpark_mj.cli.play`."""

import sys

from carpark_mj.cli.common import run_command


def run() -> int:
    """Runs the command; returns the exit code."""
    from carpark_mj.cli import play

    return play.run()


sys.exit(run_command("play", run))

"""Programs run in this process, as `carpark_mj.cli.process.enter` runs them."""

from collections.abc import Sequence
from typing import Any

from carpark_mj.cli.common import run_command


def exit_code(program: Any, arguments: Sequence[str]) -> int:
    """Runs a module's `run`; errors are a line on stderr that begins with `program`."""
    return run_command("program", lambda: program.run(arguments))

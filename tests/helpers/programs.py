"""Commands run in this process, as `carpark_mj.cli.process.enter` runs them."""

import functools
from collections.abc import Sequence
from typing import Any

from carpark_mj import programs
from carpark_mj.cli.process import run_command


def exit_code(program: Any, arguments: Sequence[str]) -> int:
    """Runs a command by name, or a module's `run`; errors are a line on stderr.

    This process is not set up as `enter` does: JAX is running in it.
    """
    if isinstance(program, str):
        return run_command(program, lambda: programs.call(program, arguments))
    return run_command("program", lambda: program.run(arguments))


layouts = functools.partial(exit_code, "layouts")
vehicles = functools.partial(exit_code, "vehicles")
identify = functools.partial(exit_code, "identify")
oracle = functools.partial(exit_code, "oracle")

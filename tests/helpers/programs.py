"""Commands run in this process as `carpark_mj.cli.process.enter` does, or apart."""

import csv
import functools
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from carpark_mj import programs
from carpark_mj.cli.process import run_command

ROOT = Path(__file__).resolve().parents[2]


def exit_code(program: Any, arguments: Sequence[str]) -> int:
    """Runs a command by name, or a module's `run`; errors are a line on stderr.

    This process is not set up as `enter` does: JAX is running in it.
    """
    if isinstance(program, str):
        return run_command(program, lambda: programs.run(program, arguments, False))
    return run_command("program", lambda: program.run(arguments))


layouts = functools.partial(exit_code, "layouts")
vehicles = functools.partial(exit_code, "vehicles")
identify = functools.partial(exit_code, "identify")


def assert_refused(capsys: Any, program: Any, arguments: Sequence[str], said: str):
    """Asserts exit code 2 and one line on stderr, which says why; returns it."""
    assert exit_code(program, arguments) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"{program if isinstance(program, str) else 'program'}: ")
    assert said in told
    assert told.count("\n") == 1
    return told


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a table that a program has written."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def python(*arguments: Any, cwd: Any = None, **variables: str | None):
    """Runs Python apart, importing this checkout; without variables that are None."""
    given = os.environ | {"PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={name: value for name, value in given.items() if value is not None},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )

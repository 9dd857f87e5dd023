"""The command line that the scripts of this folder share."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enable_output_fusion, run_command

Config = TypeVar("Config")


def command(
    config: type[Config],
    run: Callable[[Config], object],
    description: str | None,
    fused: bool = False,
) -> Callable[[Sequence[str] | None], int]:
    """The `main` of a script, which returns the exit code.

    Args:
        config: class of the settings; each field is a flag.
        run: does the work; its value is the exit code if it is an int, others mean 0.
        description: at the head of the help.
        fused: share results between loops on a CPU, see `enable_output_fusion`.
    """
    name = run.__module__
    prog = f"python eval/{name}.py"

    def main(arguments: Sequence[str] | None = None) -> int:
        if fused:
            enable_output_fusion()

        def work() -> object:
            flags = read_flags(config, arguments, description=description, prog=prog)
            return run(flags)

        return run_command(name, work)

    return main

"""The command line that the scripts of this folder share."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from carpark_mj.cli.flags import read_flags
from carpark_mj.cli.process import enable_output_fusion, run_command

Config = TypeVar("Config")


@dataclasses.dataclass(frozen=True)
class Folder:
    """Settings of a script.

    Attributes:
        out: folder of what it writes.
    """

    out: str


def command(
    config: type[Config] | Config,
    run: Callable[[Config], object],
    description: str | None,
    fused: bool = False,
) -> Callable[[Sequence[str] | None], int]:
    """The `main` of a script, which returns the exit code.

    Args:
        config: class of the settings, or their defaults; each field is a flag.
        run: does the work; its value is the exit code if it is an int, others mean 0.
        description: at the head of the help.
        fused: share results between loops on a CPU, see `enable_output_fusion`.
    """
    name, given = run.__module__, not isinstance(config, type)
    kind: Any = type(config) if given else config
    default: Any = config if given else None
    words = {"description": description, "prog": f"python eval/{name}.py"}

    def main(arguments: Sequence[str] | None = None) -> int:
        if fused:
            enable_output_fusion()
        flags = functools.partial(read_flags, kind, arguments, default, **words)
        return run_command(name, lambda: run(flags()))

    return main
